"""The closed loop in mode `return` on the full plant: servo, effort limits, gravity, contact; no camera, no network."""

from dataclasses import dataclass
from typing import Any, Self, get_type_hints

import numpy as np
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import PassThrough

from diagrams.episodes.store import of_plain
from diagrams.episodes.way_home import WayHome
from diagrams.world.clearance_map import ClearanceMap, tell_of_cans
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CANS
from diagrams.world.station import PickPlaceStation, can_body, controller_limits
from diagrams.world.task import at_home
from diagrams.world.trajectory import X_GRASP_CAN
from diagrams.world.way_home_wiring import add_way_home
from models.data.scaling import MinMaxScaling
from systems.clearance_filter import WITHIN
from systems.posture_history import PostureHistory
from systems.regulated_mixer import RegulatedMixer

TIME_LIMIT = 10.0  # s: an arm that is not at home by then has failed
GRASPED_GAP = 0.0464  # m: of the fingers at which they stall on the can, as measured on the plant
DROPPED = CAN_HALF_HEIGHT  # m: a can that slipped by more is not in the hand any longer
# rad/s, a radian in two steps of the plant: the attitude of a can that was flung out of the hand and spins faster is
# integrated wrongly, till it is no number any more.
FASTEST_SPIN = 40.0
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


@dataclass(frozen=True)
class Trajectory:
    """A way home."""

    rows: np.ndarray  # (n, 7) joint angles at the ticks, rad
    nearest: float | None  # m: smallest distance of arm and held can to anything at any step of the plant, see WayHome
    name: str | None  # the model that was that near
    filtered: int  # ticks in which the filter changed the step
    slip: float | None = None  # of the held can in the hand, m; None: there is none
    foot: float = WITHIN  # m: smallest distance of hand and held can to the arm's own foot, at the ticks, at most
    broke_off: str | None = None  # what Drake said where the simulation diverged

    def row(self) -> list[Any]:
        """Plain types, for a store."""
        return [self.rows.tolist(), *list(vars(self).values())[1:]]

    @classmethod
    def of_row(cls, row: list[Any]) -> Self:
        """From what `row` gave; raises ValueError, TypeError where it is something else."""
        rows, *others = row
        found = cls(np.array(rows, float).reshape(-1, ARM_JOINTS), *others)
        for name, kind in get_type_hints(cls).items():
            if name != "rows":
                of_plain(kind, getattr(found, name))
        if not len(found.rows):
            raise ValueError("no way home")
        return found

    def arrival(self, home: np.ndarray) -> int:
        """First tick at which every joint is at `home` (7, rad); -1 without one, or where the simulation broke off."""
        there = at_home(self.rows, home)
        return int(np.argmax(there)) if there.any() and self.broke_off is None else -1

    @property
    def touches(self) -> bool:
        """Whether arm or held can touched something, the arm's own foot too."""
        return self.closest <= 0.0

    @property
    def closest(self) -> float:
        """The smaller of `nearest` and `foot`, m; each is known up to the limit of its own."""
        return self.foot if self.nearest is None else min(self.nearest, self.foot)

    @property
    def free(self) -> bool:
        """Whether it is the LQR's alone, and known to its end: the filter changed nothing, nothing was touched."""
        return not self.filtered and not self.touches and self.broke_off is None

    @property
    def dropped(self) -> bool:
        """Whether the can is not in the hand any longer."""
        return self.slip is not None and self.slip > DROPPED


class ReturnLoop:
    """Station, PostureHistory, RegulatedMixer under alpha = 1 and the way home behind it, as the world asks for it.

    `world.regulator.offset` must be 0: here there is no tick before the first one of the way home.
    """

    def __init__(self, world: World):
        self.world = world
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, camera=False))
        initial, period = world.initial_posture, world.timing.period
        history = PostureHistory(posture_size=len(initial), horizon=0, period=period, initial_posture=initial)
        builder.AddNamedSystem("posture_history", history)
        physical = MinMaxScaling(-np.ones(len(initial)), np.ones(len(initial)))  # rad and m as they are
        mixer = builder.AddNamedSystem("regulated_mixer", regulated_mixer(world, self.station, physical))
        # Not a ConstantVectorSource: with time it would be new at each step of the plant, and the filter's answer too.
        alpha = builder.AddNamedSystem("alpha", PassThrough(1))
        builder.ExportInput(alpha.get_input_port(), "alpha")
        builder.Connect(self.station.GetOutputPort("posture"), history.GetInputPort("posture"))
        for port in ("posture", "predicted_posture"):  # under alpha = 1 the prediction has no say
            builder.Connect(history.GetOutputPort("posture"), mixer.GetInputPort(port))
        builder.Connect(alpha.get_output_port(), mixer.GetInputPort("alpha"))
        posture, desired = history.GetOutputPort("posture"), mixer.GetOutputPort("desired_posture")
        self._command = add_way_home(
            builder, world, self.station, posture, alpha.get_output_port(), desired, looks=True, regulated=True
        )
        self._map = ClearanceMap(world)
        self._unfiltered = builder.GetSubsystemByName("acceleration_limit").get_output_port()
        builder.Connect(self._command, self.station.GetInputPort("desired_posture"))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def run(self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, held: bool = False) -> Trajectory:
        """Runs home from rest at `joints` (7, rad), until a little after the arrival, or to the time limit.

        `can_xy` (2, m): where the can stands, unless it is `held`: in the closed fingers.
        """
        station, period = self.station, self.world.timing.period
        context = self._begin(joints, can_xy, vacant, held)
        local, port = station.GetMyContextFromRoot(context), station.GetOutputPort("posture")
        home, steps = self.world.initial_posture[:ARM_JOINTS], round(period / self.world.timing.time_step)
        rows, arrived, way, filtered = [np.array(joints, dtype=float)], 0, WayHome(station, own=held), 0
        foot = self._map.from_foot(port.Eval(local))
        for k in range(round(TIME_LIMIT / period)):
            try:
                for step in range(1, steps + 1):
                    self.simulator.AdvanceTo((k + step / steps) * period)
                    way.see(context, held)
                    if held:
                        self._slow_spin(context)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                words = " ".join(str(error).split())
                return Trajectory(np.array(rows), way.nearest, way.name, filtered, None, foot, words)
            filtered += not np.array_equal(self._value(context, self._command), self._value(context, self._unfiltered))
            posture = port.Eval(local).copy()
            rows.append(posture[:ARM_JOINTS])
            foot = min(foot, self._map.from_foot(posture))
            arrived += bool(at_home(rows[-1], home))
            if arrived > TICKS_AT_HOME:
                break
        slip = self._slip(context) if held else None
        return Trajectory(np.array(rows), way.nearest, way.name, filtered, slip, foot)

    def _value(self, context: Context, port: OutputPort) -> np.ndarray:
        return port.Eval(port.get_system().GetMyContextFromRoot(context))

    def _begin(self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, held: bool) -> Context:
        """The Context at the start of a run, in the simulator."""
        station, world, plant = self.station, self.world, self.station.plant
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        self.diagram.GetInputPort("alpha").FixValue(context, np.ones(1))
        station.set_scene(context, can_xy, vacant)
        local = plant.GetMyMutableContextFromRoot(context)
        plant.SetPositions(local, station.arm, joints)
        if held:
            plant.SetPositions(local, station.gripper, [0.5 * GRASPED_GAP, 0.5 * GRASPED_GAP])
            X_WC = plant.GetFrameByName("grasp").CalcPoseInWorld(local).multiply(X_GRASP_CAN)
            plant.SetFloatingBaseBodyPoseInWorldFrame(local, can_body(plant, CANS[0]), X_WC)
            plant.SetFreeBodySpatialVelocity(local, can_body(plant, CANS[0]), SpatialVelocity(np.zeros(6)))
        tell_of_cans(self.diagram, context, station)
        # The plant's step at time 0 sees the state before the tick's update: the posture, not the initial one.
        history = self.diagram.GetSubsystemByName("posture_history")
        start = np.append(joints, world.closed_opening if held else world.opening)
        history.GetMyMutableContextFromRoot(context).SetDiscreteState(0, start)
        limit = self.diagram.GetSubsystemByName("acceleration_limit")
        limit.GetMyMutableContextFromRoot(context).SetDiscreteState(0, joints)
        self.simulator.Initialize()
        return context

    def _slow_spin(self, context: Context) -> None:
        """Takes the spin from a can that is out of the hand and spins too fast for the plant's step."""
        plant = self.station.plant
        local, can = plant.GetMyMutableContextFromRoot(context), can_body(plant, CANS[0])
        velocity = plant.EvalBodySpatialVelocityInWorld(local, can)
        if np.linalg.norm(velocity.rotational()) > FASTEST_SPIN and self._slip(context) > DROPPED:
            plant.SetFreeBodySpatialVelocity(local, can, SpatialVelocity(np.zeros(3), velocity.translational()))

    def _slip(self, context: Context) -> float:
        """How far the can is from where it was put into the hand, m."""
        plant = self.station.plant
        local = plant.GetMyContextFromRoot(context)
        frame = can_body(plant, CANS[0]).body_frame()
        X_GC = frame.CalcPose(local, plant.GetFrameByName("grasp"))
        return float(np.linalg.norm(X_GC.translation() - X_GRASP_CAN.translation()))
