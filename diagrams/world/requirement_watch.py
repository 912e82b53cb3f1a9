"""The systems that watch the requirements of requirements.stl while a run goes on."""

from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from diagrams.world.clearance_meter import ClearanceMeter
from diagrams.world.configuration import World
from diagrams.world.requirement_signals import RequirementSignals
from diagrams.world.requirements import SIGNALS, requirements
from diagrams.world.station import PickPlaceStation, controller_limits
from systems.requirement_monitor import RequirementMonitor


class RequirementWatch:
    """They look, wired into a diagram, and nothing that runs depends on them.

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
        monitored: bool,
    ):
        """
        Args:
            alpha, active: (1,).
            posture, command: (8,), m_k and what the controller makes of it.
            monitored: with RequirementMonitor, without which there are the signals alone, of a run's record.
        """
        period = world.timing.period
        within = DiagramBuilder()
        meter = within.AddNamedSystem("clearance_meter", ClearanceMeter(world, station))
        signals = within.AddNamedSystem("signals", RequirementSignals(world, *controller_limits(station)))
        within.Connect(meter.get_output_port(), signals.GetInputPort("clearance"))
        within.ExportOutput(signals.get_output_port(), "signals")
        if monitored:
            monitor = within.AddNamedSystem("monitor", RequirementMonitor(requirements(period), SIGNALS, period))
            within.Connect(signals.get_output_port(), monitor.get_input_port())
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
        self.signals, self._watching, self._names = watching.GetOutputPort("signals"), watching, [*requirements(period)]

    def robustness(self, root: Context) -> dict[str, float]:
        """`robustness_of` the run so far, by its root's Context in the middle of a tick; where it is monitored."""
        port, context = self._watching.GetOutputPort("robustness"), self._watching.GetMyContextFromRoot(root)
        return dict(zip(self._names, port.Eval(context).tolist(), strict=True))
