"""The closed loop in mode `return` on the full plant: servo, effort limits, gravity, contact; no camera, no network."""

import numpy as np
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from diagrams.world.collisions import X_GRASP_CAN
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CANS
from diagrams.world.station import PickPlaceStation, can_body, controller_limits
from diagrams.world.task import at_home
from models.data.scaling import MinMaxScaling
from systems.posture_history import PostureHistory
from systems.regulated_mixer import RegulatedMixer

TIME_LIMIT = 10.0  # s: an arm that is not at home by then has failed
GRASPED_GAP = 0.0464  # m: of the fingers at which they stall on the can, as measured on the plant
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

    def run(
        self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, held: bool = False
    ) -> tuple[np.ndarray, float | None, str | None]:
        """Runs home from rest at `joints` (7, rad), until a little after the arrival, or to the time limit.

        `can_xy` (2, m): where the can stands, unless it is `held`: in the closed fingers.

        Returns (n, 7) joint angles at the ticks, rad; how far the held can has slipped in the hand at the end, m, None
        without one; and what Drake said where the simulation diverged, else None.
        """
        station, period = self.station, self.world.timing.period
        context = self._begin(joints, can_xy, vacant, held)
        local, port = station.GetMyContextFromRoot(context), station.GetOutputPort("posture")
        home = self.world.initial_posture[:ARM_JOINTS]
        rows, arrived = [np.array(joints, dtype=float)], 0
        for k in range(1, round(TIME_LIMIT / period) + 1):
            try:
                self.simulator.AdvanceTo(k * period)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                return np.array(rows), None, " ".join(str(error).split())
            rows.append(port.Eval(local)[:ARM_JOINTS].copy())
            arrived += bool(at_home(rows[-1], home))
            if arrived > TICKS_AT_HOME:
                break
        return np.array(rows), self._slip(context) if held else None, None

    def _begin(self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, held: bool) -> Context:
        """The Context at the start of a run, in the simulator."""
        station, world, plant = self.station, self.world, self.station.plant
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        station.set_scene(context, can_xy, vacant)
        local = plant.GetMyMutableContextFromRoot(context)
        plant.SetPositions(local, station.arm, joints)
        if held:
            plant.SetPositions(local, station.gripper, [0.5 * GRASPED_GAP, 0.5 * GRASPED_GAP])
            X_WC = plant.GetFrameByName("grasp").CalcPoseInWorld(local).multiply(X_GRASP_CAN)
            plant.SetFloatingBaseBodyPoseInWorldFrame(local, can_body(plant, CANS[0]), X_WC)
            plant.SetFreeBodySpatialVelocity(local, can_body(plant, CANS[0]), SpatialVelocity(np.zeros(6)))
        # The plant's step at time 0 sees the state before the tick's update: the posture, not the initial one.
        history = self.diagram.GetSubsystemByName("posture_history")
        start = np.append(joints, world.closed_opening if held else world.opening)
        history.GetMyMutableContextFromRoot(context).SetDiscreteState(0, start)
        self.simulator.Initialize()
        return context

    def _slip(self, context: Context) -> float:
        """How far the can is from where it was put into the hand, m."""
        plant = self.station.plant
        local = plant.GetMyContextFromRoot(context)
        frame = can_body(plant, CANS[0]).body_frame()
        X_GC = frame.CalcPose(local, plant.GetFrameByName("grasp"))
        return float(np.linalg.norm(X_GC.translation() - X_GRASP_CAN.translation()))
