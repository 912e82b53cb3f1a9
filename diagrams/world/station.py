"""PickPlaceStation: the arm, the desk, the shelf, the cans and the camera as one Diagram."""

import ctypes
import os
import sys

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngine,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import (
    GetScopedFrameByName,
    LoadModelDirectives,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PdControllerGains, RigidBody
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import MatrixGain, Multiplexer
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from diagrams.world.approach_meter import ApproachMeter
from diagrams.world.can_mover import declare_can_place, declare_pose
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CANS, DIRECTIVES, FINGERS, SPOTS, other_spot
from diagrams.world.parts import CAMERAS, require_parts
from models.command_line import ROOT
from models.errors import InputError

RENDERER = "vtk"
FILM = (960, 720, 42.0)  # width, height (pixels) and vertical field of view (deg) of the camera for people


def add_models(plant: MultibodyPlant, world: World, names: tuple[str, ...] | None = None) -> None:
    """Adds the models of `world` to `plant`; with `names`, only those, and their welds.

    Raises InputError where its file is not there, does not fit, or lacks a part that others look up.
    """
    file, parser = ROOT / "sdf" / world.models, Parser(plant)
    parser.package_map().AddPackageXml(str(ROOT / "sdf" / "package.xml"))
    if not file.is_file():
        there = ", ".join(sorted(path.name for path in file.parent.glob(f"*{DIRECTIVES}")))
        raise InputError(f"there is no file sdf/{world.models} (world.models): choose from {there}")
    try:
        directives = LoadModelDirectives(str(file)).directives
        _add_directives(plant, parser, world, directives, names)
    except RuntimeError as error:
        raise InputError(f"sdf/{world.models} does not fit: {' '.join(str(error).split())}") from error
    require_parts(plant, world, names)


def _add_directives(
    plant: MultibodyPlant, parser: Parser, world: World, directives: list, names: tuple[str, ...] | None
) -> None:
    models = [d.add_model for d in directives if d.add_model and (not names or d.add_model.name in names)]
    welds = [d.add_weld for d in directives if d.add_weld and (not names or d.add_weld.child.split("::")[0] in names)]
    if any(model.default_joint_positions or model.default_free_body_pose for model in models):
        raise InputError(f"sdf/{world.models} gives a model defaults: give them in PickPlaceStation._set_defaults")
    # Not by ProcessModelDirectives: for each file that Drake opens, libsdformat reads its schema anew, which takes
    # 25 ms; for what a string includes, it does so once a process.
    included = "".join(f"<include><uri>{model.file}</uri><name>{model.name}</name></include>" for model in models)
    parser.AddModelsFromString(f'<sdf version="1.9"><world name="models">{included}</world></sdf>', "sdf")
    others = [d for d in directives if not d.add_model and not d.add_weld]
    ProcessModelDirectives(ModelDirectives(directives=others), parser)
    for weld in welds:
        parent, child = (GetScopedFrameByName(plant, name) for name in (weld.parent, weld.child))
        plant.WeldFrames(parent, child, weld.X_PC.GetDeterministicValue() if weld.X_PC else RigidTransform())


def can_body(plant: MultibodyPlant, name: str) -> RigidBody:
    """The body of the can `name` (see CANS) in `plant`."""
    return plant.GetBodyByName("can", plant.GetModelInstanceByName(name))


def arm_plant(world: World) -> MultibodyPlant:
    """Arm and gripper of `world` alone, continuous: for kinematics and gravity. Positions: 7 joints, 2 fingers."""
    plant = MultibodyPlant(0.0)
    add_models(plant, world, ("arm", "gripper"))
    plant.Finalize()
    return plant


def _require_egl_device() -> None:
    """Raises RuntimeError where EGL has no device to render on: Drake would die of it at the first picture."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:  # Drake looks under another name too, and raises where there is none
        return
    egl.eglGetProcAddress.restype = egl.eglGetDisplay.restype = ctypes.c_void_p
    count = ctypes.c_int(0)
    if address := egl.eglGetProcAddress(b"eglQueryDevicesEXT"):
        query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int))(address)
        query(0, None, ctypes.byref(count))
    if not count.value and not egl.eglGetDisplay(None):
        raise RuntimeError("no EGL device")


def renderer() -> RenderEngine:
    """The renderer of every camera, without a display; raises InputError where there is none."""
    params = RenderEngineVtkParams()
    params.default_clear_color = [0.78, 0.82, 0.86]
    # Without a display; elsewhere than on Linux the default needs none.
    params.backend = "EGL" if sys.platform == "linux" else ""
    params.lights = [
        LightParameter(type="directional", direction=[-0.80, -0.25, -0.60], intensity=0.75, frame="world"),
        LightParameter(type="directional", direction=[-0.10, 0.60, -0.80], intensity=0.55, frame="world"),
    ]
    try:
        if params.backend == "EGL":
            _require_egl_device()
        return MakeRenderEngineVtk(params)
    except RuntimeError as error:
        raise InputError(
            f"the camera cannot render without a display: EGL is not usable here ({error}); "
            "install it (Debian and Ubuntu: apt-get install libegl1 libgl1)"
        ) from error


class PickPlaceStation(Diagram):
    """The robot and its world.

    .. pydrake_system::

        name: PickPlaceStation
        input_ports:
        - desired_posture
        - told_posture
        - can_place
        - can_pose
        - neighbour_pose
        - applied_spatial_force
        output_ports:
        - posture
        - joint_angles
        - finger_gap
        - rgb_image
        - can_poses
        - approach_distance
        - query_object
        - film_image

    - `desired_posture` (8): joint angles, rad, and gap of the fingers, m, that the servo tracks.
    - `can_place` (2): see `declare_can_place`; need not be connected.
    - `applied_spatial_force`: list of ExternallyAppliedSpatialForce on bodies of the plant; with pulled=True only.
    - `can_pose` (7): quaternion wxyz and position, m, world, of the can to pick, see `declare_pose`; only in `extra`.
    - `neighbour_pose` (7): the same of the other can; only in `extra`.
    - `told_posture` (8): what `posture` takes the fingers' command from, instead of `desired_posture`; as the next one.
    - `joint_angles` (7): as they are, rad, at any time; only in `extra`.
    - `posture` (8): measured joint angles, rad, and the gap of the fingers as commanded, m.
    - `finger_gap` (1): that gap as measured, m; it stalls on the can.
    - `rgb_image`: RGBA image of the fixed camera, `World.camera` pixels; absent with camera=False.
    - `can_poses` (14): see ApproachMeter.
    - `approach_distance` (1): see ApproachMeter. Truth: for scoring and disturbances, never for the controller.
    - `query_object`: Drake's QueryObject of the plant's scene graph, for pictures and for distances (m).
    - `film_image`: RGBA image of a camera for people, `FILM` pixels; with film_camera=True only.
    """

    def __init__(self, world: World, camera=True, film_camera=False, pulled=False, extra: tuple[str, ...] = ()):
        """`camera`: render for the network; `film_camera`: for people too; `pulled`: with a port for forces.

        `extra`: more ports that a fault needs, see above. Raises InputError without a renderer.
        """
        super().__init__()
        self.world = world
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(
            time_step=world.timing.time_step,
            discrete_contact_approximation="sap",
            contact_model="point",
            # The controller's updates at tick k read the state at the tick itself, not one plant step later.
            use_sampled_output_ports=False,
        )
        self.plant, self.scene_graph = AddMultibodyPlant(config, builder)
        add_models(self.plant, world)
        self._set_servo()
        self._set_defaults()
        self.plant.Finalize()
        self._set_default_cans()
        self.arm = self.plant.GetModelInstanceByName("arm")
        self.gripper = self.plant.GetModelInstanceByName("gripper")
        self._wire_servo(builder, told="joint_angles" in extra)
        self._wire_gravity_compensation(builder)
        builder.ExportInput(declare_can_place(self.plant, can_body(self.plant, CANS[0]), world.timing), "can_place")
        for name, can in zip(("can_pose", "neighbour_pose"), CANS, strict=True):
            if name in extra:
                builder.ExportInput(declare_pose(self.plant, can_body(self.plant, can), world.timing, name), name)
        if pulled:
            builder.ExportInput(self.plant.get_applied_spatial_force_input_port(), "applied_spatial_force")
        if camera:
            self._add_camera(builder, film_camera)
        self.approach_meter = builder.AddNamedSystem("approach_meter", ApproachMeter(self.plant))
        builder.Connect(self.plant.get_body_poses_output_port(), self.approach_meter.GetInputPort("body_poses"))
        builder.ExportOutput(self.approach_meter.GetOutputPort("can_poses"), "can_poses")
        builder.ExportOutput(self.approach_meter.GetOutputPort("approach_distance"), "approach_distance")
        builder.ExportOutput(self.scene_graph.get_query_output_port(), "query_object")
        builder.BuildInto(self)
        self.set_name("station")

    def _set_servo(self) -> None:
        servo = self.world.servo
        # By name: before Finalize, the look-up by model instance returns nothing, and gains would silently not be set.
        for j in range(ARM_JOINTS):
            actuator = self.plant.GetJointActuatorByName(f"joint_{j + 1}")
            actuator.set_controller_gains(PdControllerGains(p=servo.stiffness[j], d=servo.damping[j]))
        finger = self.plant.GetJointActuatorByName("left_finger_joint")
        finger.set_controller_gains(PdControllerGains(p=servo.finger_stiffness, d=servo.finger_damping))
        left, right = (self.plant.GetJointByName(f"{side}_finger_joint") for side in FINGERS)
        # Two effort-limited fingers would drift sideways with the can: the right one mirrors the left one.
        self.plant.AddCouplerConstraint(joint0=right, joint1=left, gear_ratio=1.0, offset=0.0)

    def _set_defaults(self) -> None:
        posture = self.world.initial_posture
        for j in range(ARM_JOINTS):
            self.plant.GetJointByName(f"joint_{j + 1}").set_default_angle(posture[j])
        for side in FINGERS:
            self.plant.GetJointByName(f"{side}_finger_joint").set_default_translation(posture[-1] / 2)

    def _set_default_cans(self) -> None:
        centre = np.mean(self.world.grid.bounds, axis=0)
        shelf = np.mean([self.spot(name) for name in SPOTS], axis=0)
        for can, xyz in zip(CANS, ([*centre, CAN_HALF_HEIGHT], shelf), strict=True):
            self.plant.SetDefaultFloatingBaseBodyPose(can_body(self.plant, can), RigidTransform(xyz))

    def _wire_servo(self, builder: DiagramBuilder, told: bool) -> None:
        n, eye = ARM_JOINTS, np.eye(ARM_JOINTS + 1)
        opening = builder.AddNamedSystem("opening", MatrixGain(eye[n:]))
        # Desired states: positions, then velocities 0.
        arm_state, finger_state = np.vstack([eye[:n], 0 * eye[:n]]), np.vstack([0.5 * eye[n:], 0 * eye[n:]])
        arm_target = builder.AddNamedSystem("arm_target", MatrixGain(arm_state))
        finger_target = builder.AddNamedSystem("finger_target", MatrixGain(finger_state))
        joints = builder.AddNamedSystem("joints", MatrixGain(np.eye(n, 2 * n)))
        posture = builder.AddNamedSystem("posture", Multiplexer([n, 1]))
        builder.ExportInput(arm_target.get_input_port(), "desired_posture")
        builder.ConnectInput("desired_posture", finger_target.get_input_port())
        if told:
            builder.ExportInput(opening.get_input_port(), "told_posture")
            builder.ExportOutput(joints.get_output_port(), "joint_angles")
        else:
            builder.ConnectInput("desired_posture", opening.get_input_port())
        builder.Connect(arm_target.get_output_port(), self.plant.get_desired_state_input_port(self.arm))
        builder.Connect(finger_target.get_output_port(), self.plant.get_desired_state_input_port(self.gripper))
        builder.Connect(self.plant.get_state_output_port(self.arm), joints.get_input_port())
        builder.Connect(joints.get_output_port(), posture.get_input_port(0))
        builder.Connect(opening.get_output_port(), posture.get_input_port(1))
        builder.ExportOutput(posture.get_output_port(0), "posture")
        gap = builder.AddNamedSystem("finger_gap", MatrixGain(np.array([[1.0, 1.0, 0.0, 0.0]])))
        builder.Connect(self.plant.get_state_output_port(self.gripper), gap.get_input_port())
        builder.ExportOutput(gap.get_output_port(), "finger_gap")

    def _wire_gravity_compensation(self, builder: DiagramBuilder) -> None:
        self.arm_plant = arm_plant(self.world)
        n, gravity = ARM_JOINTS, InverseDynamics.InverseDynamicsMode.kGravityCompensation
        compensation = builder.AddNamedSystem("gravity_compensation", InverseDynamics(self.arm_plant, gravity))
        states = builder.AddNamedSystem("arm_and_finger_states", Multiplexer([2 * n, 4]))
        # (q_arm, v_arm, q_fingers, v_fingers) -> (q_arm, q_fingers, v_arm, v_fingers); there are two fingers.
        order = np.r_[:n, 2 * n : 2 * n + 2, n : 2 * n, 2 * n + 2 : 2 * n + 4]
        reorder = builder.AddNamedSystem("state_order", MatrixGain(np.eye(len(order))[order]))
        torque = builder.AddNamedSystem("arm_torque", MatrixGain(np.eye(n, n + 2)))
        builder.Connect(self.plant.get_state_output_port(self.arm), states.get_input_port(0))
        builder.Connect(self.plant.get_state_output_port(self.gripper), states.get_input_port(1))
        builder.Connect(states.get_output_port(0), reorder.get_input_port())
        builder.Connect(reorder.get_output_port(), compensation.get_input_port_estimated_state())
        builder.Connect(compensation.get_output_port_generalized_force(), torque.get_input_port())
        builder.Connect(torque.get_output_port(), self.plant.get_actuation_input_port(self.arm))

    def _add_camera(self, builder: DiagramBuilder, film_camera: bool) -> None:
        # The renderer looks at a copy of the scene graph that follows the plant's positions: it moves its shapes when
        # an image is pulled, ten times a second; in the plant's own scene graph it would do so at every step of the
        # plant, which takes longer than the physics.
        scene = builder.AddNamedSystem("camera_scene", self.scene_graph.Clone())
        poses = builder.AddNamedSystem("camera_scene_poses", MultibodyPositionToGeometryPose(self.plant, True))
        builder.Connect(self.plant.get_state_output_port(), poses.get_input_port())
        builder.Connect(poses.get_output_port(), scene.get_source_pose_port(self.plant.get_source_id()))
        if not film_camera:
            # In software, the calling thread draws a picture this small faster than it wakes others for it.
            os.environ.setdefault("LP_NUM_THREADS", "0")
        scene.AddRenderer(RENDERER, renderer())
        camera = self.world.camera
        self._add_sensor(builder, scene, CAMERAS[0], "rgb_image", camera.width, camera.height, camera.field_of_view_deg)
        if film_camera:
            self._add_sensor(builder, scene, CAMERAS[1], "film_image", *FILM)

    def _add_sensor(self, builder, scene, frame_name: str, port: str, width: int, height: int, fov_deg: float) -> None:
        info = CameraInfo(width=width, height=height, fov_y=np.deg2rad(fov_deg))
        core = RenderCameraCore(RENDERER, info, ClippingRange(0.1, 5.0), RigidTransform())
        colour, depth = ColorRenderCamera(core), DepthRenderCamera(core, DepthRange(0.2, 4.0))
        frame = self.plant.GetFrameByName(frame_name)
        body = self.plant.GetBodyFrameIdOrThrow(frame.body().index())
        sensor = RgbdSensor(body, frame.GetFixedPoseInBodyFrame(), colour, depth)
        builder.AddNamedSystem(frame_name, sensor)
        builder.Connect(scene.get_query_output_port(), sensor.query_object_input_port())
        builder.ExportOutput(sensor.color_image_output_port(), port)

    def set_scene(self, context: Context, can_xy: np.ndarray, vacant: str, turn: float = 0.0) -> None:
        """Stands one can at rest on the desk, the other on the spot that is not `vacant`.

        `can_xy` (2, m, world): of the can to pick, whose axis is turned by `turn` (rad).
        """
        plant, (can, other) = self.plant, (can_body(self.plant, name) for name in CANS)
        plant_context = plant.GetMyMutableContextFromRoot(context)
        X_WC = RigidTransform(RollPitchYaw(0, 0, turn), [*can_xy, CAN_HALF_HEIGHT])
        plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, can, X_WC)
        plant.SetFreeBodySpatialVelocity(context=plant_context, body=can, V_JpJc=SpatialVelocity(np.zeros(6)))
        plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, other, RigidTransform(self.spot(other_spot(vacant))))
        self.approach_meter.set_place(self.approach_meter.GetMyMutableContextFromRoot(context), self.spot(vacant))

    def finger_gap(self, context: Context) -> float:
        """Measured gap of the fingers, m, in a root's Context."""
        return float(self.GetOutputPort("finger_gap").Eval(self.GetMyContextFromRoot(context))[0])

    def spot(self, name: str) -> np.ndarray:
        """See `spot_centre`."""
        return spot_centre(self.plant, name)


def spot_centre(plant: MultibodyPlant, name: str) -> np.ndarray:
    """(3,) centre of a can that stands on spot `name` of the shelf in `plant`, m, world."""
    X_WS = plant.GetFrameByName(f"{name}_spot").CalcPoseInWorld(plant.CreateDefaultContext())
    return X_WS.translation() + [0, 0, CAN_HALF_HEIGHT]


def controller_limits(station: PickPlaceStation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper limits of the command (8,), rad and m, and its largest speed (8,), per s, from the model."""
    joints = [station.plant.GetJointByName(f"joint_{j + 1}") for j in range(ARM_JOINTS)]
    finger = station.plant.GetJointByName("left_finger_joint")
    lower = [j.position_lower_limit() for j in joints] + [0.0]
    upper = [j.position_upper_limit() for j in joints] + [2 * finger.position_upper_limit()]
    speed = [j.velocity_upper_limit() for j in joints] + [2 * finger.velocity_upper_limit()]
    return np.array(lower), np.array(upper), np.array(speed)
