"""The station: the arm against its public figures, the servo, the wiring."""

import re

import numpy as np
import pytest
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JointActuatorIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, LogVectorOutput, Sine, ZeroOrderHold

from diagrams.world.configuration import Timing, World
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, SPOTS
from diagrams.world.station import PickPlaceStation, add_models, arm_plant, controller_limits
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.world.station_runs import play, posture, start, taught

# The public figures of the 7-axis arm, as sdf/torobo_arm.sdf states them: limits (deg), effort (N m), speed (deg/s).
TABLE = [
    (-160, 160, 60, 120),
    (-45, 105, 60, 120),
    (-160, 160, 25, 180),
    (-45, 105, 25, 180),
    (-160, 160, 11, 180),
    (-90, 90, 11, 180),
    (-160, 160, 5, 180),
]


# Forward kinematics, by hand. Even joints turn about y at q = 0 (positive: forwards, to x), odd ones about the limb;
# shoulder 0.24 above the mounting face, upper arm 0.31, forearm 0.31, wrist to flange 0.175.
HALF = np.sqrt(0.5)


@pytest.mark.parametrize(
    ("degrees", "position"),
    [
        ({}, [0, 0, 1.035]),
        ({2: 90}, [0.795, 0, 0.24]),  # stretched ahead: shoulder to flange 0.795
        ({1: 90, 2: 90}, [0, 0.795, 0.24]),  # stretched to the left
        ({2: -45}, [-0.795 * HALF, 0, 0.24 + 0.795 * HALF]),
        ({4: 90}, [0.485, 0, 0.55]),
        ({3: 90, 4: 90}, [0, 0.485, 0.55]),
        ({6: 90}, [0.175, 0, 0.86]),
        ({5: -90, 6: 90}, [0, -0.175, 0.86]),
        ({2: 45, 4: -45}, [0.31 * HALF, 0, 0.24 + 0.31 * HALF + 0.485]),
        ({2: 90, 4: 90, 6: 90}, [0.31 - 0.175, 0, 0.24 - 0.31]),
        ({1: 10, 3: 20, 5: 30, 7: 40}, [0, 0, 1.035]),  # all about the vertical
    ],
)
def test_forward_kinematics_by_hand(degrees, position):
    plant = arm_plant(World())
    context = plant.CreateDefaultContext()
    for j in range(1, ARM_JOINTS + 1):
        plant.GetJointByName(f"joint_{j}").set_angle(context, np.deg2rad(degrees.get(j, 0.0)))
    face = plant.GetFrameByName("base").CalcPoseInWorld(context)
    flange = plant.GetFrameByName("flange").CalcPoseInWorld(context)
    assert face.inverse().multiply(flange).translation() == pytest.approx(position, abs=1e-9)


def test_the_last_joint_turns_the_flange():
    plant = arm_plant(World())
    context = plant.CreateDefaultContext()
    plant.GetJointByName("joint_7").set_angle(context, np.deg2rad(90))
    R = plant.GetFrameByName("flange").CalcPoseInWorld(context).rotation().matrix()
    assert np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) == pytest.approx(R, abs=1e-9)


@pytest.mark.parametrize("j", range(ARM_JOINTS))
def test_limits_efforts_and_speeds_are_the_public_figures(station, j):
    lower, upper, effort, speed = TABLE[j]
    joint = station.plant.GetJointByName(f"joint_{j + 1}")
    limits = [joint.position_lower_limit(), joint.position_upper_limit(), joint.velocity_upper_limit()]
    assert np.rad2deg(limits) == pytest.approx([lower, upper, speed])
    assert station.plant.GetJointActuatorByName(f"joint_{j + 1}").effort_limit() == effort


def test_the_models_are_those_that_drake_reads_from_the_directives():
    """Each body of the same model, with the same mass, at the same place."""
    own, drakes = MultibodyPlant(0.0), MultibodyPlant(0.0)
    add_models(own, World())
    parser = Parser(drakes)
    parser.package_map().AddPackageXml(str(ROOT / "sdf" / "package.xml"))
    ProcessModelDirectives(LoadModelDirectives(str(ROOT / "sdf" / "pick_place.dmd.yaml")), parser)

    def bodies(plant):
        plant.Finalize()
        context = plant.CreateDefaultContext()
        found = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]  # 0 is the world
        return [
            (str(b.scoped_name()), b.default_mass(), b.EvalPoseInWorld(context).GetAsMatrix34().tobytes())
            for b in found
        ]

    assert bodies(own) == bodies(drakes)
    assert own.num_joints() == drakes.num_joints()


def test_the_fingers_open_four_centimetres_each(station):
    for side in SPOTS:
        joint = station.plant.GetJointByName(f"{side}_finger_joint")
        assert (joint.position_lower_limit(), joint.position_upper_limit()) == (0.0, 0.04)


def test_limits_of_the_command_are_those_of_the_model(station):
    lower, upper, speed = controller_limits(station)
    assert np.rad2deg(lower[:-1]) == pytest.approx([row[0] for row in TABLE])
    assert np.rad2deg(upper[:-1]) == pytest.approx([row[1] for row in TABLE])
    assert np.rad2deg(speed[:-1]) == pytest.approx([row[3] for row in TABLE])
    assert (lower[-1], upper[-1], speed[-1]) == (0.0, 0.08, 1.0)  # both fingers together


def test_ports_are_those_of_the_docstring(world):
    station = PickPlaceStation(world, True, True, True, ("joint_angles", "can_pose", "neighbour_pose"))
    block = re.search(r"pydrake_system::(.*?)\n\n(?!\s+name:)", PickPlaceStation.__doc__, re.DOTALL).group(1)
    inputs, outputs = (re.findall(r"- (\w+)", part) for part in block.split("output_ports:"))
    assert sorted(re.findall(r"^ *- `(\w+)`", PickPlaceStation.__doc__, re.MULTILINE)) == sorted(inputs + outputs)
    found = [station.get_output_port(i).get_name() for i in range(station.num_output_ports())]
    assert inputs == [station.get_input_port(i).get_name() for i in range(station.num_input_ports())]
    assert sorted(outputs) == sorted(found)
    sizes = {name: station.GetOutputPort(name).size() for name in ("posture", "can_poses", "approach_distance")}
    assert sizes == {"posture": 8, "can_poses": 14, "approach_distance": 1}
    assert station.GetInputPort("desired_posture").size() == 8


def test_only_the_opening_feeds_through(station):
    """Else the command would meet the posture that it was made from in an algebraic loop."""
    command = station.GetInputPort("desired_posture").get_index()
    through = {
        station.get_output_port(i).get_name()
        for i in range(station.num_output_ports())
        if station.HasDirectFeedthrough(command, i)
    }
    assert through == {"posture"}
    context = station.CreateDefaultContext()
    station.GetInputPort("desired_posture").FixValue(context, np.arange(8.0))
    assert posture(station, context) == pytest.approx([*station.world.initial_posture[:7], 7.0])


def test_topology(station):
    names = {system.get_name() for system in station.GetSystems()}
    assert {
        "plant", "scene_graph", "gravity_compensation", "camera", "camera_scene", "approach_meter", "posture",
    } <= names  # fmt: skip
    wires = {(source.get_name(), target.get_name()) for (target, _), (source, _) in station.connection_map().items()}
    assert wires >= {
        ("plant", "scene_graph"),
        ("scene_graph", "plant"),
        ("arm_target", "plant"),
        ("finger_target", "plant"),
        ("state_order", "gravity_compensation"),
        ("gravity_compensation", "arm_torque"),
        ("arm_torque", "plant"),
        ("plant", "joints"),
        ("plant", "camera_scene_poses"),
        ("camera_scene_poses", "camera_scene"),
        ("camera_scene", "camera"),
        ("plant", "approach_meter"),
    }


def test_the_plant_renders_nothing_itself(station):
    """A renderer in the plant's scene graph would move its shapes at every step: longer than the physics takes."""
    assert station.scene_graph.RendererCount() == 0
    assert station.GetSubsystemByName("camera_scene").RendererCount() == 1


def test_outputs_of_the_plant_are_not_sampled(station):
    assert not station.plant.has_sampled_output_ports()


def late_ticks(time_step, count):
    """How many of `count` ticks, by a 10 Hz update, see another posture than the plant has after k * 0.1 s of steps."""
    world = World(timing=Timing(time_step=time_step))
    period, steps = world.timing.period, round(world.timing.period / time_step)
    builder = DiagramBuilder()
    station = builder.AddSystem(PickPlaceStation(world, camera=False))
    swing = np.array([0.3, 0.2, 0.3, 0.2, 0.3, 0.3, 0.3, 0.0])  # rad: never twice the same posture
    sine = builder.AddSystem(Sine(swing, np.linspace(1.0, 2.0, 8), np.zeros(8)))
    home, command = builder.AddSystem(ConstantVectorSource(world.initial_posture)), builder.AddSystem(Adder(2, 8))
    update = builder.AddSystem(ZeroOrderHold(period, 8))
    builder.Connect(sine.get_output_port(0), command.get_input_port(0))
    builder.Connect(home.get_output_port(), command.get_input_port(1))
    builder.Connect(command.get_output_port(), station.GetInputPort("desired_posture"))
    builder.Connect(station.GetOutputPort("posture"), update.get_input_port())
    after_steps = LogVectorOutput(station.GetOutputPort("posture"), builder, time_step)  # row n: after n steps
    simulator = Simulator(builder.Build())
    seen = []
    for k in range(count):
        simulator.AdvanceTo((k + 0.5) * period)
        seen.append(update.get_output_port().Eval(update.GetMyContextFromRoot(simulator.get_context())))
    rows = after_steps.FindLog(simulator.get_context()).data().T[::steps][:count]
    assert np.abs(np.diff(rows[:, :7], axis=0)).max(axis=1).min() > 1e-4  # it moves meanwhile
    return np.count_nonzero((np.array(seen) != rows).any(axis=1))


def test_no_update_of_1000_sees_the_posture_a_step_late(world):
    assert late_ticks(world.timing.time_step, 1000) == 0


def test_a_step_that_is_not_exact_in_binary_is_late_and_is_refused():
    beside = [k for k in range(1, 100) if k * 0.1 != 10 * k * 0.01]
    assert late_ticks(0.01, 100) == len(beside) > 10
    with pytest.raises(InputError, match=r"time_step 0\.01 s: .* choose 0\.0125"):
        World(timing=Timing(time_step=0.01)).check()


def test_defaults_of_a_model_are_not_passed_over(monkeypatch, tmp_path):
    text = (ROOT / "sdf" / "pick_place.dmd.yaml").read_text()
    (tmp_path / "sdf").mkdir()
    given = "    name: arm\n    default_joint_positions:\n        joint_1: [0.5]\n"
    assert "    name: arm\n" in text
    (tmp_path / "sdf" / "pick_place.dmd.yaml").write_text(text.replace("    name: arm\n", given, 1))
    (tmp_path / "sdf" / "package.xml").write_text((ROOT / "sdf" / "package.xml").read_text())
    monkeypatch.setattr("diagrams.world.station.ROOT", tmp_path)
    with pytest.raises(InputError, match="gives a model defaults"):
        arm_plant(World())


def test_servo_gains_are_really_set(station):
    servo = station.world.servo
    gains = [station.plant.GetJointActuatorByName(f"joint_{j + 1}").get_controller_gains() for j in range(ARM_JOINTS)]
    assert [g.p for g in gains] == servo.stiffness
    assert [g.d for g in gains] == servo.damping
    finger = station.plant.GetJointActuatorByName("left_finger_joint")
    assert finger.get_controller_gains().p == servo.finger_stiffness > 0
    actuators = [station.plant.get_joint_actuator(JointActuatorIndex(i)) for i in range(station.plant.num_actuators())]
    assert {a.name() for a in actuators if a.has_controller() and a.effort_limit() > 0} == {
        *(f"joint_{j + 1}" for j in range(ARM_JOINTS)),
        "left_finger_joint",
    }


def test_gravity_is_on(station):
    plant = station.plant
    assert plant.gravity_field().gravity_vector() == pytest.approx([0, 0, -9.81])
    for model in ("arm", "gripper", "can_to_pick", "can_on_shelf"):
        assert plant.is_gravity_enabled(plant.GetModelInstanceByName(model))


@pytest.mark.parametrize("seed", range(3))
def test_compensation_is_gravity_of_arm_and_gripper(station, seed):
    plant, context = station.plant, station.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    rng = np.random.default_rng(seed)
    joints = np.deg2rad([rng.uniform(row[0], row[1]) for row in TABLE])
    plant.SetPositions(plant_context, station.arm, joints)
    torque = station.GetSubsystemByName("arm_torque")
    found = torque.get_output_port().Eval(torque.GetMyContextFromRoot(context))
    gravity = plant.GetVelocitiesFromArray(station.arm, plant.CalcGravityGeneralizedForces(plant_context))
    assert found == pytest.approx(-gravity, abs=1e-9)
    assert np.abs(found).max() > 1.0  # N m: there is something to compensate


@pytest.mark.parametrize("offset_deg", [[0] * 7, [-20, 25, 30, -30, 40, -50, 60]])
def test_arm_holds_still(world, offset_deg):
    station = PickPlaceStation(world, camera=False)
    simulator = start(station)
    goal = world.initial_posture + np.append(np.deg2rad(offset_deg), 0.0)
    play(station, simulator, np.linspace(world.initial_posture, goal, 20))
    play(station, simulator, [goal] * 20)
    assert posture(station, simulator.get_context()) == pytest.approx(goal, abs=1e-5)


def test_efforts_stay_within_the_limits(world):
    station = PickPlaceStation(world, camera=False)
    simulator = start(station)
    port = station.plant.get_net_actuation_output_port(station.arm)
    plant_context = station.plant.GetMyContextFromRoot(simulator.get_context())
    goal = world.initial_posture + np.array([0.8, -0.8, 0.8, -0.8, 0.8, -0.8, 0.8, 0])
    station.GetInputPort("desired_posture").FixValue(simulator.get_mutable_context(), goal)
    efforts = []
    for step in range(1, 60):
        simulator.AdvanceTo(step * world.timing.time_step)
        efforts.append(np.abs(port.Eval(plant_context)))
    limits = np.array([row[2] for row in TABLE])
    assert np.all(np.max(efforts, axis=0) <= limits + 1e-9)
    assert np.max(efforts, axis=0) == pytest.approx(limits, rel=1e-6)  # such a jump asks each joint for all it has


def test_replay_gives_the_same_bits(station, hand):
    def run():
        simulator, bits = start(station, (0.5, 0.05)), []
        rows = taught(station, hand, (0.5, 0.05), "left", 1)[55:75]

        def log(context):
            plant = station.plant
            state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(context))
            bits.append(state.tobytes())
            bits.append(station.GetOutputPort("rgb_image").Eval(context).data.tobytes())

        play(station, simulator, rows, log)
        return bits

    assert run() == run()


def test_scene_is_as_asked_for(station):
    context = station.CreateDefaultContext()
    station.set_scene(context, np.array([0.46, 0.05]), "left", turn=0.5)
    cans = station.GetOutputPort("can_poses").Eval(context)
    assert cans[4:7] == pytest.approx([0.46, 0.05, CAN_HALF_HEIGHT])
    assert cans[:4] == pytest.approx([np.cos(0.25), 0, 0, np.sin(0.25)])
    assert cans[11:] == pytest.approx(station.spot("right"))
    station.set_scene(context, np.array([0.46, 0.05]), "right")
    assert station.GetOutputPort("can_poses").Eval(context)[11:] == pytest.approx(station.spot("left"))


def test_cans_stand_still_where_they_are_put(world):
    station = PickPlaceStation(world, camera=False)
    simulator = start(station, (0.6, -0.05))
    before = station.GetOutputPort("can_poses").Eval(simulator.get_context())
    play(station, simulator, [world.initial_posture] * 20)
    assert station.GetOutputPort("can_poses").Eval(simulator.get_context()) == pytest.approx(before, abs=5e-4)


def test_a_can_that_falls_from_the_desk_lands(world):
    """Without a floor it would fall and spin for ever, until its attitude is no number any more."""
    station = PickPlaceStation(world, camera=False)
    simulator = start(station, (1.2, 0.0))
    plant_context = station.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    spin = SpatialVelocity(w=[30.0, 40.0, 0.0], v=[0.5, 0.0, 0.0])
    can = station.plant.GetBodyByName("can", station.plant.GetModelInstanceByName("can_to_pick"))
    station.plant.SetFreeBodySpatialVelocity(context=plant_context, body=can, V_JpJc=spin)
    play(station, simulator, [world.initial_posture] * 100)
    height = station.GetOutputPort("can_poses").Eval(simulator.get_context())[6]
    assert -0.72 < height < -0.72 + 2 * CAN_HALF_HEIGHT


def test_spots_lie_on_the_shelf(station):
    left, right = (station.spot(name) for name in SPOTS)
    assert (left[2], right[2]) == pytest.approx((0.05 + CAN_HALF_HEIGHT, 0.05 + CAN_HALF_HEIGHT))
    assert np.linalg.norm(left - right) == pytest.approx(0.13)


def test_unknown_spot_is_refused(station):
    with pytest.raises(InputError, match=r"no spot 'middle'.*choose one of left, right"):
        station.set_scene(station.CreateDefaultContext(), np.array([0.5, 0.0]), "middle")


def test_approach_distance(station, hand, world):
    context = station.CreateDefaultContext()
    station.set_scene(context, np.array([0.5, 0.0]), "left")
    meter = station.approach_meter
    meter_context = meter.GetMyMutableContextFromRoot(context)
    distance = station.GetOutputPort("approach_distance")
    grasp = hand.grasp_position(world.initial_posture[:7])
    can = np.array([0.5, 0.0, CAN_HALF_HEIGHT])
    assert distance.Eval(context) == pytest.approx([np.linalg.norm(grasp - can)])
    meter.set_subtask(meter_context, 2)
    assert distance.Eval(context) == pytest.approx([np.linalg.norm(station.spot("left") - can)])
