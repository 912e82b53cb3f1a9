"""A world in one file, and the second one: the iiwa against its public figures, its reach, its task, its way home."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from diagrams import pick_place
from diagrams.episodes.compatibility import facts, require_trained_for
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.world.clearance_map import ClearanceMap, clearance_filter
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, SPOTS
from diagrams.world.parts import PARTS
from diagrams.world.scenario import Scenario, load_scenario, load_world, save_scenario
from diagrams.world.station import PickPlaceStation, arm_plant, controller_limits
from diagrams.world.teacher import Teacher, setups
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, HOVER, SUBTASK_STEPS, subtask_commands
from models.command_line import ROOT
from models.errors import InputError
from systems.disturbance import MOVE_TICKS
from tests.diagrams.world.station_runs import hand_to_can, play, start, taught

FILE = ROOT / "sdf" / "iiwa.world.yaml"
# The public figures of the LBR iiwa 14 R820: limit (deg), effort (N m), speed (deg/s).
TABLE = [
    (170, 320, 85),
    (120, 320, 85),
    (170, 176, 100),
    (120, 176, 75),
    (170, 110, 130),
    (120, 40, 135),
    (175, 40, 135),
]


@pytest.fixture(scope="module")
def iiwa():
    return load_world(FILE)


@pytest.fixture(scope="module")
def station(iiwa):
    return PickPlaceStation(iiwa, camera=False)


@pytest.fixture(scope="module")
def hand(iiwa):
    return HandKinematics(iiwa)


# By hand: shoulder 0.36 above the mounting face, upper arm 0.42, forearm 0.40, wrist to flange 0.126. Joints 2 and 6
# turn forwards, joint 4 backwards, odd ones about the limb.
@pytest.mark.parametrize(
    ("degrees", "position"),
    [
        ({}, [0, 0, 1.306]),
        ({2: 90}, [0.946, 0, 0.36]),
        ({1: 90, 2: 90}, [0, 0.946, 0.36]),
        ({4: -90}, [0.526, 0, 0.78]),
        ({3: 90, 4: -90}, [0, 0.526, 0.78]),
        ({6: 90}, [0.126, 0, 1.18]),
        ({5: 90, 6: 90}, [0, 0.126, 1.18]),
        ({2: 90, 4: -90, 6: -90}, [0.42 + 0.126, 0, 0.36 - 0.40]),
        ({1: 10, 3: 20, 5: 30, 7: 40}, [0, 0, 1.306]),
    ],
)
def test_forward_kinematics_by_hand(iiwa, degrees, position):
    plant = arm_plant(iiwa)
    context = plant.CreateDefaultContext()
    for j in range(1, ARM_JOINTS + 1):
        plant.GetJointByName(f"joint_{j}").set_angle(context, np.deg2rad(degrees.get(j, 0.0)))
    face = plant.GetFrameByName("base").CalcPoseInWorld(context)
    flange = plant.GetFrameByName("flange").CalcPoseInWorld(context)
    assert face.inverse().multiply(flange).translation() == pytest.approx(position, abs=1e-9)


def test_limits_efforts_and_speeds_are_the_public_figures(station):
    for j, (limit, effort, speed) in enumerate(TABLE, start=1):
        joint = station.plant.GetJointByName(f"joint_{j}")
        limits = [joint.position_lower_limit(), joint.position_upper_limit(), joint.velocity_upper_limit()]
        assert np.rad2deg(limits) == pytest.approx([-limit, limit, speed])
        assert station.plant.GetJointActuatorByName(f"joint_{j}").effort_limit() == effort
    assert np.rad2deg(controller_limits(station)[2][:ARM_JOINTS]) == pytest.approx([row[2] for row in TABLE])


def test_the_hand_reaches_the_whole_grid_and_both_spots(iiwa, hand, station):
    places = [[*iiwa.grid.position(i, j), CAN_HALF_HEIGHT] for i in range(10) for j in range(10)]
    for place in [*places, *(station.spot(spot) for spot in SPOTS)]:
        for height in (0.0, HOVER):
            joints = hand.solve_ik(np.asarray(place) + [0, 0, GRASP_ABOVE_CENTRE + height])
            assert hand.margin(joints) > np.deg2rad(15.0)


def test_the_teacher_keeps_within_half_of_the_speeds(iiwa, hand, station):
    most = controller_limits(station)[2][:ARM_JOINTS] * iiwa.timing.period
    goals = [*iiwa.grid.position(9, 0), CAN_HALF_HEIGHT], station.spot("left")
    for subtask, goal in enumerate(goals, start=1):
        rows = subtask_commands(iiwa, hand, np.asarray(goal), subtask)[:, :ARM_JOINTS]
        assert np.all(np.abs(np.diff(rows, axis=0)).max(axis=0) < 0.5 * most)


@pytest.mark.parametrize("number", [18, 181])  # the nearest corner at the left, the farthest at the right; a spot each
def test_demonstrations_succeed_and_the_can_is_seen(iiwa, number):
    given = Teacher(iiwa).demonstrate(setups(iiwa, 0)[number])
    assert given.success
    assert len(given.rgb) == sum(SUBTASK_STEPS)
    red = (given.rgb[..., 0] > 90) & (given.rgb[..., 1:] < 40).all(axis=-1)
    assert red[0].sum() >= 20
    rows, columns = np.nonzero(red[0])
    assert columns.min() > 0
    assert max(rows.max(), columns.max()) < 109


def test_the_way_home_knows_its_desk_and_shelf(iiwa, station):
    map, home = ClearanceMap(iiwa), iiwa.initial_posture[:ARM_JOINTS]
    assert clearance_filter(iiwa, station) is not None
    # By hand, the stretched arm: 0.42 from joint 1 and 2 to 3 and 4, 0.40 on, 0.081 to joint 7.
    assert map.reach[1] - map.reach[3] == pytest.approx(0.42, abs=0.02)
    assert map.reach[3] - map.reach[5] == pytest.approx(0.40, abs=0.02)
    assert map.reach[5] - map.reach[6] == pytest.approx(0.081)
    for opening in (iiwa.opening, iiwa.closed_opening):
        view = map.view(np.append(home, opening), np.empty(0))
        assert view.nearest(home, 0.3, np.empty(0, int)) > 0.1
    on_shelf = HandKinematics(iiwa).solve_ik(station.spot("left") - [0, 0, 0.04])  # the finger tips 7 mm in it
    view = map.view(np.append(home, iiwa.opening), np.empty(0))
    assert view.nearest(on_shelf, 0.3, np.empty(0, int)) < 0.0


def test_disturbances_are_sampled_for_this_arm(iiwa, hand):
    sampler = EpisodeSampler(iiwa)
    for seed in range(6):
        episode = sampler.sample(seed, "A")
        assert hand.margin(np.array(episode.disturbance.target)) > 0.0
        assert np.all(np.abs(np.array(episode.can_xy) - np.mean(iiwa.grid.bounds, axis=0)) < 0.1)


@pytest.mark.parametrize("seed", [1050005, 1050015])  # with three times the gains the arm threw it away
def test_a_disturbance_leaves_the_can_in_the_hand(iiwa, hand, station, seed):
    episode = EpisodeSampler(iiwa).sample(seed, "A")
    given, scene = episode.disturbance, (episode.can_xy, episode.vacant)
    assert given.subtask == 2
    simulator = start(station, *scene)
    context = simulator.get_mutable_context()
    play(station, simulator, taught(station, hand, *scene, subtask=1))
    before, command = hand_to_can(station, context), iiwa.initial_posture
    for command in taught(station, hand, *scene, subtask=2):
        play(station, simulator, [command])
        can = station.GetOutputPort("can_poses").Eval(context)[4:7]
        if np.linalg.norm(can - station.spot(episode.vacant)) < given.level:
            break
    target = np.append(given.target, command[-1])
    shares = np.minimum(np.arange(1, MOVE_TICKS + given.hold_ticks + 1) / MOVE_TICKS, 1.0)
    play(station, simulator, [command + share * (target - command) for share in shares])
    slip = before.inverse().multiply(hand_to_can(station, context))
    assert np.linalg.norm(slip.translation()) < 0.02
    assert slip.rotation().ToAngleAxis().angle() < np.deg2rad(20.0)


def test_a_network_of_another_arm_is_refused(iiwa):
    def trained_in(world, told):
        metadata = {"world": json.loads(json.dumps(facts(world)))} if told else {}
        return SimpleNamespace(initial_posture=world.initial_posture, metadata=metadata)

    require_trained_for(iiwa, trained_in(iiwa, True))
    require_trained_for(World(), trained_in(World(), False))
    alike = replace(World(), models="iiwa.dmd.yaml")  # in all but the arm
    for told in (True, False):
        with pytest.raises(InputError, match=r"models is 'iiwa.dmd.yaml', the network .* 'pick_place.dmd.yaml'"):
            require_trained_for(alike, trained_in(World(), told))
    with pytest.raises(InputError, match=r"models is 'pick_place.dmd.yaml', the network .* 'iiwa.dmd.yaml'"):
        require_trained_for(World(), trained_in(alike, True))
    assert fingerprint(iiwa)["world.models"] == "iiwa.dmd.yaml"


@pytest.fixture
def copied(monkeypatch, tmp_path):
    """A copy of sdf/ that the station reads."""
    (tmp_path / "sdf").mkdir()
    for file in (ROOT / "sdf").iterdir():
        (tmp_path / "sdf" / file.name).write_text(file.read_text())
    monkeypatch.setattr("diagrams.world.station.ROOT", tmp_path)
    return tmp_path / "sdf"


def change(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("iiwa.dmd.yaml", "name: can_on_shelf", "name: tin", "has no model 'can_on_shelf'"),
        ("iiwa.dmd.yaml", "name: film_camera", "name: lens", "has no frame 'film_camera'"),
        ("iiwa.dmd.yaml", "child: shelf::shelf", "child: shelf::board", "does not fit: .*board"),
        ("iiwa.dmd.yaml", "iiwa_desk.sdf", "no_desk.sdf", "does not fit: .*no_desk.sdf"),
        ("iiwa.dmd.yaml", "directives:", "direktives:", "does not fit: .*direktives"),
        ("iiwa_arm.sdf", "link_1", "first_link", "'arm' has no body 'link_1'"),
        ("iiwa_arm.sdf", 'joint_7"', 'last_joint"', "does not fit|'arm' has no joint 'joint_7'"),
        ("iiwa_arm.sdf", "<effort>320</effort>", "<effort>0</effort>", "'arm' has no actuator 'joint_1'"),
        ("gripper.sdf", 'frame name="grasp"', 'frame name="tip"', "'gripper' has no frame 'grasp'"),
        ("shelf.sdf", "left_spot", "upper_spot", "'shelf' has no frame 'left_spot'"),
    ],
)
def test_what_a_models_file_lacks_is_named(iiwa, copied, file, old, new, named):
    change(copied / file, old, new)
    with pytest.raises(InputError, match=rf"sdf/iiwa.dmd.yaml.*{named}"):
        PickPlaceStation(iiwa, camera=False)


def test_every_models_file_has_all_parts():
    for file in (ROOT / "sdf").glob("*.dmd.yaml"):
        plant = PickPlaceStation(replace(World(), models=file.name), camera=False).plant
        assert all(plant.HasModelInstanceNamed(name) for name in PARTS)


def test_a_world_that_is_not_there_is_named(tmp_path, iiwa):
    with pytest.raises(InputError, match=r"no world file .*none\.yaml"):
        load_world(tmp_path / "none.yaml")
    (tmp_path / "w.yaml").write_text("world: {empty_below: 0.0}\n")  # a scenario
    with pytest.raises(InputError, match=r"world file .*w\.yaml does not fit: .*world.*those of World in"):
        load_world(tmp_path / "w.yaml")
    (tmp_path / "w.yaml").write_text("models: ../sdf/iiwa.dmd.yaml\n")
    with pytest.raises(InputError, match=r"world.models '\.\./sdf/iiwa.dmd.yaml' is no file's name in sdf/"):
        load_world(tmp_path / "w.yaml")
    with pytest.raises(InputError, match=r"no file sdf/ur5.dmd.yaml .*choose from iiwa.dmd.yaml, pick_place.dmd.yaml"):
        arm_plant(replace(iiwa, models="ur5.dmd.yaml"))


def test_a_world_file_goes_over_the_defaults(tmp_path):
    (tmp_path / "w.yaml").write_text("grid: {corner: [0.5, 0.0]}\n")
    world = load_world(tmp_path / "w.yaml")
    assert (world.grid.corner, world.grid.spacing, world.models) == ([0.5, 0.0], 0.02, "pick_place.dmd.yaml")


def test_options_go_over_a_scenario_and_that_over_the_world_file(tmp_path):
    (tmp_path / "s.yaml").write_text("seed: 5\nworld: {opening: 0.075, clearance: {gap: 0.012}}\n")
    cli = pick_place.parse(
        ["--world", str(FILE), "--scenario", str(tmp_path / "s.yaml"), "--world.clearance.gap", "0.015"]
    )
    assert (cli.seed, cli.world.models, cli.world.opening, cli.world.clearance.gap) == (
        5,
        "iiwa.dmd.yaml",
        0.075,
        0.015,
    )
    assert pick_place.parse(["--world", str(FILE)]).world == load_world(FILE)
    assert pick_place.parse([]).world == World()


def test_a_counterexample_carries_its_world(tmp_path, iiwa):
    save_scenario(tmp_path / "s.yaml", Scenario(world=iiwa))
    assert load_scenario(tmp_path / "s.yaml").world == iiwa


def test_the_page_s_look_before_teaching(tmp_path, monkeypatch, capsys):
    page = (ROOT / "diagrams" / "YOUR_ARM.md").read_text()
    (look,) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "sdf").symlink_to(ROOT / "sdf")
    monkeypatch.chdir(tmp_path)
    exec(compile(look, "YOUR_ARM.md", "exec"), {})
    margins = [float(found) for found in re.findall(r"limit: ([\d.]+) deg", capsys.readouterr().out)]
    assert len(margins) == 6
    assert min(margins) > 15.0
    assert cv2.imread("look.png").shape == (4 * 112, 4 * 4 * 112, 3)
