"""A person's hands in the diagram: what they did, tick by tick, and the systems that do it again."""

import numpy as np
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder

from diagrams.world.configuration import World
from diagrams.world.hands_schedule import INITIAL, HandsSchedule, require_force, require_gamma, require_share
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation
from models.errors import InputError
from systems.body_force import BodyForce
from systems.camera_fault import FAULTS, CameraFault
from systems.disturbance import MOVE_TICKS, DisturbanceParameters
from systems.faults.fault import Setting
from systems.faults.late_step import LateStep
from systems.first_given import FirstGiven
from systems.manual_disturbance import FREE, HOLD, MOVE, ManualDisturbance
from systems.signal_schedule import SignalSchedule

HELD_TICKS = 10  # at the posture to which the arm was moved, as of disturbance A


class Hands:
    """The systems of a person's hands, wired between the parts of a Rollout.

    Attributes:
        signals: output ports, those of the constructor with these in their places: rgb_image, the picture for the
            controller; desired_posture, the command for the arm; can_place, where the can is put (2,); active, how
            many, the experimenter and the person, hold or move the arm: 0 to 2, pulls not counted; spatial_force.
        gamma: output port: the detector's gamma (1,), NaN for its own.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        world: World,
        station: PickPlaceStation,
        signals: dict[str, OutputPort],
    ):
        """Adds them to `builder`; `signals`: as they are without a person, see the attribute.

        And `spatial_force`, if a fault pulls at the arm too.
        """
        period, plant = world.timing.period, station.plant
        image, command, active, place = (
            signals[name] for name in ("rgb_image", "desired_posture", "active", "can_place")
        )
        self._schedules = {
            name: builder.AddNamedSystem(f"hands_{name}", SignalSchedule(initial=initial, period=period))
            for name, initial in INITIAL.items()
        }
        self.gamma, camera, grip, force, can = (
            self._schedules[name].get_output_port() for name in ("gamma", "camera", "grip", "force", "can")
        )
        setting = Setting(command.size(), ARM_JOINTS, period, world.camera.width, world.camera.height, {})
        self._late_step = builder.AddNamedSystem("late_step", LateStep(setting, told=True))
        builder.Connect(self._schedules["late"].get_output_port(), self._late_step.GetInputPort("share"))
        fault = builder.AddNamedSystem("camera_fault", CameraFault(world.camera.width, world.camera.height, period))
        builder.Connect(image, fault.GetInputPort("rgb_image"))
        builder.Connect(camera, fault.GetInputPort("fault"))
        hand = builder.AddNamedSystem(
            "manual_disturbance", ManualDisturbance(posture_size=command.size(), joints=ARM_JOINTS, period=period)
        )
        builder.Connect(command, hand.GetInputPort("desired_posture"))
        builder.Connect(grip, hand.GetInputPort("grip"))
        grasp = plant.GetFrameByName("grasp")
        pull = builder.AddNamedSystem(
            "pull", BodyForce(grasp.body().index(), grasp.GetFixedPoseInBodyFrame().translation())
        )
        builder.Connect(force, pull.get_input_port())
        forces = pull.get_output_port()
        if "spatial_force" in signals:
            both = builder.AddNamedSystem("forces", ExternallyAppliedSpatialForceMultiplexer(2))
            for i, port in enumerate((forces, signals["spatial_force"])):
                builder.Connect(port, both.get_input_port(i))
            forces = both.get_output_port()
        self.signals = signals | {"spatial_force": forces}
        first = builder.AddNamedSystem("can_place", FirstGiven(place.size()))
        builder.Connect(can, first.GetInputPort("first"))
        builder.Connect(place, first.GetInputPort("second"))
        either = builder.AddNamedSystem("disturbed", Adder(2, 1))
        builder.Connect(active, either.get_input_port(0))
        builder.Connect(hand.GetOutputPort("active"), either.get_input_port(1))
        self.signals |= {"rgb_image": fault.get_output_port(), "can_place": first.get_output_port()}
        self.signals |= {"desired_posture": hand.GetOutputPort("disturbed_posture"), "active": either.get_output_port()}

    def late(self, builder: DiagramBuilder, command: OutputPort) -> OutputPort:
        """What the experimenter, and the arm, get of the controller's `command`, whose step may be late."""
        builder.Connect(command, self._late_step.GetInputPort("desired_posture"))
        return self._late_step.GetOutputPort("faulty_desired_posture")

    def set(self, root: Context, schedule: HandsSchedule, seed: int) -> None:
        """Puts all of `schedule` into the root's Context, and the `seed` of which steps are late.

        Raises InputError as the `check` of the schedule does.
        """
        schedule.check()
        own = self._late_step.GetMyMutableContextFromRoot(root)
        self._late_step.set_parameters(own, DisturbanceParameters(severity=0.0), seed)
        for name, rows in vars(schedule).items():
            points = [(int(tick), values) for tick, *values in rows]
            if name == "can":  # each for one tick
                ticks = {tick for tick, _ in points}
                points += [(tick + 1, INITIAL[name]) for tick in ticks if tick + 1 not in ticks]
            system = self._schedules[name]
            system.set_points(system.GetMyMutableContextFromRoot(root), sorted(points))

    def schedule(self, root: Context) -> HandsSchedule:
        """What is in the root's Context."""
        rows = {
            name: [[tick, *values] for tick, values in system.points(system.GetMyContextFromRoot(root))]
            for name, system in self._schedules.items()
        }
        rows["can"] = [row for row in rows["can"] if not np.isnan(row).any()]
        return HandsSchedule(**{name: [list(map(float, row)) for row in found] for name, found in rows.items()})

    def newest(self, root: Context, name: str) -> np.ndarray:
        """The values of the last change to `name`, as in INITIAL; those of INITIAL where there was none."""
        system = self._schedules[name]
        points = system.points(system.GetMyContextFromRoot(root))
        return np.array(points[-1][1] if points else INITIAL[name])

    def _change(self, root: Context, name: str, tick: int, values) -> None:
        system = self._schedules[name]
        system.change(system.GetMyMutableContextFromRoot(root), tick, values)

    def hold(self, root: Context, tick: int, held: bool) -> None:
        """From `tick` on, which has not begun, as in all that follows, the arm is held, or let go.

        Where it is being moved, it is let go at the end of that.
        """
        system = self._schedules["grip"]
        points = system.points(system.GetMyContextFromRoot(root))
        if not held and points:
            tick = max(tick, points[-1][0])
        self._change(root, "grip", tick, [HOLD if held else FREE, *INITIAL["grip"][1:]])

    def move(self, root: Context, tick: int, target: np.ndarray, held: bool = False) -> None:
        """The arm is moved to `target` (7,), rad, held there, and let go, as under A; `held`: or held on."""
        self._change(root, "grip", tick, [MOVE, *target])
        self._change(root, "grip", tick + MOVE_TICKS + HELD_TICKS, [HOLD if held else FREE, *INITIAL["grip"][1:]])

    def pull(self, root: Context, tick: int, force: np.ndarray) -> None:
        """The hand is pulled by `force` (3,), N, world; raises InputError beyond LARGEST_FORCE."""
        require_force(force)
        self._change(root, "force", tick, force)

    def put_can(self, root: Context, tick: int, place: np.ndarray) -> None:
        """The can is put at `place` (2,), m, world, on the desk, in the middle of `tick`."""
        self._change(root, "can", tick, place)
        self._change(root, "can", tick + 1, INITIAL["can"])

    def fault(self, root: Context, tick: int, kind: str) -> None:
        """The camera has a fault of FAULTS; raises InputError for another one."""
        if kind not in FAULTS:
            raise InputError(f"there is no camera fault '{kind}': choose from {', '.join(FAULTS)}")
        self._change(root, "camera", tick, [FAULTS.index(kind)])

    def delay(self, root: Context, tick: int, share: float) -> None:
        """So large a share of the controller's steps are late; raises InputError outside of [0, 1]."""
        require_share(share)
        self._change(root, "late", tick, [share])

    def set_gamma(self, root: Context, tick: int, gamma: float) -> None:
        """The detector's gamma; raises InputError outside of GAMMAS."""
        require_gamma(gamma)
        self._change(root, "gamma", tick, [gamma])
