"""The requirements of requirements.stl, watched in the diagram and evaluated on records."""

import functools
from pathlib import Path

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from diagrams.world.clearance_meter import ClearanceMeter
from diagrams.world.configuration import World
from diagrams.world.requirement_signals import SIGNALS, RequirementSignals
from diagrams.world.station import PickPlaceStation, controller_limits
from systems.requirement_monitor import RequirementMonitor
from systems.signal_logic import Formula, holds, robustness
from systems.signal_logic_text import load_requirements

FILE = Path(__file__).with_name("requirements.stl")


@functools.cache
def requirements(period: float) -> dict[str, Formula]:
    """Those in FILE, by name, for ticks of `period` s; raises InputError where something in it does not fit."""
    return load_requirements(FILE, SIGNALS, period)


def robustness_of(signals: np.ndarray, period: float) -> dict[str, float]:
    """By how much a run keeps each requirement, in the unit of its signals; negative: it is broken.

    `signals`: (n, 7) a row a tick, as RequirementSignals gives them; `period`: of the ticks, s.
    """
    columns = dict(zip(SIGNALS, signals.T, strict=True))
    return {name: float(robustness(formula, columns)[0]) for name, formula in requirements(period).items()}


def broken(signals: np.ndarray, period: float) -> list[str]:
    """Names of the requirements that a run breaks; as `robustness_of`, and exact where that is 0."""
    columns = dict(zip(SIGNALS, signals.T, strict=True))
    return [name for name, formula in requirements(period).items() if not holds(formula, columns)[0]]


class Requirements:
    """The systems that watch a run, wired into a diagram: they look, and nothing that runs depends on them.

    Attributes:
        signals: output port (7,), see RequirementSignals.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        world: World,
        station: PickPlaceStation,
        alpha: OutputPort,
        active: OutputPort,
        posture: OutputPort,
        command: OutputPort,
    ):
        """`alpha`, `active`: (1,); `posture`, `command`: (8,), m_k and what the controller makes of it."""
        period = world.timing.period
        within = DiagramBuilder()
        meter = within.AddNamedSystem("clearance_meter", ClearanceMeter(world, station))
        signals = within.AddNamedSystem("signals", RequirementSignals(world, *controller_limits(station)))
        monitor = within.AddNamedSystem("monitor", RequirementMonitor(requirements(period), SIGNALS, period))
        within.Connect(meter.get_output_port(), signals.GetInputPort("clearance"))
        within.Connect(signals.get_output_port(), monitor.get_input_port())
        within.ExportOutput(signals.get_output_port(), "signals")
        within.ExportOutput(monitor.get_output_port(), "robustness")
        within.ExportInput(meter.GetInputPort("query_object"), "query_object")
        given = {"alpha": alpha, "active": active, "posture": posture}
        for name in given:
            within.ExportInput(signals.GetInputPort(name), name)
            within.ConnectInput(name, meter.GetInputPort(name))
        within.ExportInput(signals.GetInputPort("desired_posture"), "desired_posture")
        watching = builder.AddNamedSystem("requirements", within.Build())
        given |= {"desired_posture": command, "query_object": station.GetOutputPort("query_object")}
        for name, port in given.items():
            builder.Connect(port, watching.GetInputPort(name))
        self.signals, self._watching, self._names = watching.GetOutputPort("signals"), watching, requirements(period)

    def robustness(self, root: Context) -> dict[str, float]:
        """`robustness_of` the run so far, by its root's Context in the middle of a tick."""
        port, context = self._watching.GetOutputPort("robustness"), self._watching.GetMyContextFromRoot(root)
        return dict(zip(self._names, port.Eval(context).tolist(), strict=True))
