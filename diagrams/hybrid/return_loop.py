"""The closed loop in mode `return` on the full plant: servo, effort limits, gravity, contact; no camera, no network."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import at_home
from models.data.scaling import MinMaxScaling
from systems.posture_history import PostureHistory
from systems.regulated_mixer import RegulatedMixer

TIME_LIMIT = 10.0  # s: an arm that is not at home by then has failed
TICKS_AT_HOME = 5  # simulated beyond the arrival, for V


def regulated_mixer(world: World, station: PickPlaceStation, scaling: MinMaxScaling) -> RegulatedMixer:
    """The LQR and Eq. 3 for the arm of `station`, in the units of `scaling`."""
    lower, upper, speed = controller_limits(station)

    def fingers(*values: float) -> list[np.ndarray]:
        return [scaling.scale(np.full(len(lower), value))[ARM_JOINTS:] for value in values]

    return RegulatedMixer(
        posture_size=len(lower),
        joints=ARM_JOINTS,
        initial_posture=scaling.scale(world.initial_posture),
        Q=world.regulator.state_weight,
        R=world.regulator.input_weight,
        period=world.timing.period,
        lower=scaling.scale(lower),
        upper=scaling.scale(upper),
        max_step=(speed * world.timing.period / scaling.half_range)[:ARM_JOINTS],
        finger_openings=fingers(world.closed_opening, world.opening),
        finger_thresholds=fingers(world.close_below, world.open_above),
    )


class ReturnLoop:
    """Station, PostureHistory and RegulatedMixer under alpha = 1."""

    def __init__(self, world: World):
        self.world = world
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, camera=False))
        initial, period = world.initial_posture, world.timing.period
        history = PostureHistory(posture_size=len(initial), horizon=0, period=period, initial_posture=initial)
        builder.AddNamedSystem("posture_history", history)
        physical = MinMaxScaling(-np.ones(len(initial)), np.ones(len(initial)))  # rad and m as they are
        mixer = builder.AddNamedSystem("regulated_mixer", regulated_mixer(world, self.station, physical))
        alpha = builder.AddNamedSystem("alpha", ConstantVectorSource(np.ones(1)))
        builder.Connect(self.station.GetOutputPort("posture"), history.GetInputPort("posture"))
        for port in ("posture", "predicted_posture"):  # under alpha = 1 the prediction has no say
            builder.Connect(history.GetOutputPort("posture"), mixer.GetInputPort(port))
        builder.Connect(alpha.get_output_port(), mixer.GetInputPort("alpha"))
        builder.Connect(mixer.GetOutputPort("desired_posture"), self.station.GetInputPort("desired_posture"))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def run(self, joints: np.ndarray, can_xy: np.ndarray, vacant: str) -> tuple[np.ndarray, str | None]:
        """Runs home from rest at `joints` (7, rad), until a little after the arrival, or to the time limit.

        Returns (n, 7) joint angles at the ticks, rad, and what Drake said where the simulation diverged, else None.
        """
        station, period = self.station, self.world.timing.period
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        station.set_scene(context, can_xy, vacant)
        station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(context), station.arm, joints)
        self.simulator.Initialize()
        local, port = station.GetMyContextFromRoot(context), station.GetOutputPort("posture")
        home = self.world.initial_posture[:ARM_JOINTS]
        rows, arrived = [np.array(joints, dtype=float)], 0
        for k in range(1, round(TIME_LIMIT / period) + 1):
            try:
                self.simulator.AdvanceTo(k * period)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                return np.array(rows), " ".join(str(error).split())
            rows.append(port.Eval(local)[:ARM_JOINTS].copy())
            arrived += bool(at_home(rows[-1], home))
            if arrived > TICKS_AT_HOME:
                break
        return np.array(rows), None
