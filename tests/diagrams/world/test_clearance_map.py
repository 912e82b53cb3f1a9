"""ClearanceMap: distances by hand, the reach, what is there and what is not, and why the arm cannot meet itself."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Role
from pydrake.planning import RobotDiagramBuilder

from diagrams.world.clearance_map import ClearanceMap, clearance_filter
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import Clearance, World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CANS, LIMIT_MARGIN
from diagrams.world.scenario import load_world
from diagrams.world.station import PickPlaceStation, add_models, can_body
from diagrams.world.trajectory import X_GRASP_CAN, subtask_commands
from models.command_line import ROOT
from models.errors import InputError
from systems.clearance_filter import WITHIN
from tests.systems.system_checks import evaluate

WORLD = World()
HOME = WORLD.initial_posture
OPEN, CLOSED = WORLD.opening, WORLD.closed_opening
NOTHING = np.empty(0)
FINGERTIP = 0.017  # m: the fingers' boxes end that far beyond the grasp frame


@pytest.fixture(scope="module")
def hand():
    return HandKinematics(WORLD)


@pytest.fixture(scope="module")
def possible():
    return ClearanceMap(WORLD)


@pytest.fixture(scope="module")
def true():
    return ClearanceMap(WORLD, possible=False)


@pytest.fixture(scope="module")
def station():
    return PickPlaceStation(WORLD, camera=False)


def can_poses(first, second):
    return np.concatenate([[1.0, 0, 0, 0, *first], [1.0, 0, 0, 0, *second]])


def nearest(map, joints, opening, obstacles=NOTHING, within=0.3):
    view = map.view(np.append(joints, opening), obstacles)
    return view.near(joints, within).distances.min(initial=within)


def test_a_held_can_is_where_it_was_grasped(possible, hand, station):
    # 3 cm above the shelf's left spot, which a can stands on for all the map knows: what overlaps it is not there.
    spot = station.spot("left")
    joints = hand.solve_ik(spot + [0, 0, 0.03 + 0.01])
    assert nearest(possible, joints, CLOSED, within=0.1) == pytest.approx(0.03, abs=0.004)  # it leans by some degrees
    # Open fingers stand on either side of the can that may be there: 80 mm for 53.
    assert nearest(possible, joints, OPEN, within=0.1) == pytest.approx(0.0135, abs=0.002)


def test_a_held_can_alone_may_have_slid(possible, hand, station):
    joints = hand.solve_ik(station.spot("left") + [0, 0, 0.04])
    margins = possible.view(np.append(joints, CLOSED), NOTHING).near(joints, WITHIN).margins
    assert set(margins) == {0.0, WORLD.clearance.slip}
    assert not possible.view(np.append(joints, OPEN), NOTHING).near(joints, WITHIN).margins.any()


def test_a_can_may_stand_wherever_one_may(possible, hand, station):
    centre = np.array([*np.mean(WORLD.grid.bounds, axis=0), CAN_HALF_HEIGHT])
    above = hand.solve_ik(centre + [0, 0, CAN_HALF_HEIGHT + 0.10])
    assert nearest(possible, above, OPEN) == pytest.approx(0.10 - FINGERTIP, abs=0.004)
    for spot in ("left", "right"):
        above = hand.solve_ik(station.spot(spot) + [0, 0, CAN_HALF_HEIGHT + 0.06])
        assert nearest(possible, above, OPEN) == pytest.approx(0.06 - FINGERTIP, abs=0.006)


def test_a_can_that_the_arm_overlaps_is_not_there(possible, hand, station):
    spot = station.spot("left")
    joints = hand.solve_ik(spot + [0, 0, 0.05])
    view = possible.view(np.append(joints, CLOSED), NOTHING)
    assert view.near(joints, 0.0).distances.size == 0  # the held can is where the possible one would be
    # As long as the view is of that posture, not even where the hand goes meanwhile; the other spot's can is there.
    other = hand.solve_ik(station.spot("right") + [0, 0, 0.05])
    assert view.near(hand.solve_ik(spot + [0, 0, 0.02]), 0.0).distances.size == 0
    assert view.near(other, 0.0).distances.min() < -0.02


def test_the_truth_is_what_the_map_is_told(true, hand, station):
    desk, right = np.array([0.53, 0.0, CAN_HALF_HEIGHT]), station.spot("right")
    above = hand.solve_ik(desk + [0, 0, CAN_HALF_HEIGHT + 0.08])
    assert nearest(true, above, OPEN, can_poses(desk, right)) == pytest.approx(0.08 - FINGERTIP, abs=0.004)
    away = desk + [0, 0.5, 0]  # then the desk is nearest
    assert nearest(true, above, OPEN, can_poses(away, right)) > 0.15
    # Held: the can moves with the hand, wherever exactly it is told to be.
    held = desk + [0, 0, CAN_HALF_HEIGHT + 0.07]
    assert nearest(true, above, CLOSED, can_poses(held, right)) == pytest.approx(0.12, abs=0.006)
    assert nearest(true, above, CLOSED, can_poses(away, right)) > 0.15  # it was taken


def test_jacobians_are_the_derivatives(possible, hand, station):
    joints = hand.solve_ik(station.spot("left") + [0.02, 0.03, 0.08])
    view, step = possible.view(np.append(joints, CLOSED), NOTHING), 1e-6
    near = view.near(joints, WITHIN)
    assert len(near.pairs) > 5
    order = np.argsort(near.distances)[:3]
    for j, unit in enumerate(np.eye(ARM_JOINTS)):
        ahead, behind = (view.near(joints + sign * step * unit, WITHIN) for sign in (1, -1))
        slope = (ahead.distances[order] - behind.distances[order]) / (2 * step)
        np.testing.assert_allclose(near.jacobians[order, j], slope, atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, ARM_JOINTS - 1))
def test_property_no_distance_falls_faster_than_the_reach_says(seed, joint):
    """What the proof of a step rests on: each distance is Lipschitz in each joint angle.

    But for the error of Drake's distance between two cylinders or a cylinder and a box: in 15 of 6,000 such pairs of
    postures a tenth of a milliradian apart, a distance below WITHIN jumped, by at most 1.6 % of itself.
    """
    map, rng = _map(), np.random.default_rng(seed)
    start = HOME[:ARM_JOINTS] + rng.uniform(-0.6, 0.6, ARM_JOINTS)
    turn = rng.uniform(-0.3, 0.3)
    view = map.view(np.append(HOME[:ARM_JOINTS], rng.choice([OPEN, CLOSED])), NOTHING)
    found = [view.near(start + share * turn * np.eye(ARM_JOINTS)[joint], 2.0) for share in (0.0, 1.0)]
    before, after = (nearest_of_pairs(near) for near in found)
    assert len(before) > 20
    for pair in before:
        if before[pair] < WITHIN:
            error = 1e-4 + 0.02 * abs(before[pair])
            assert abs(before[pair] - after[pair]) <= map.reach[joint] * abs(turn) + error


def nearest_of_pairs(near):
    return {pair: near.distances[near.pairs == pair].min() for pair in np.unique(near.pairs)}


def test_the_reach_is_not_much_more_than_the_arm_has(possible, hand):
    """Stretched out, the held can's end moves nearly as fast as the reach of joint 2 says."""
    stretched = np.zeros(ARM_JOINTS)
    view = possible.view(np.append(HOME[:ARM_JOINTS], CLOSED), NOTHING)
    slopes = np.abs(view.near(stretched + np.deg2rad([0, 80, 0, 0, 0, 0, 0]), 2.0).jacobians).max(axis=0)
    assert slopes[1] > 0.85 * possible.reach[1]


def commands_of(hand, station, can_xy, vacant):
    """Both subtasks as the teacher shows them, the fingers as commanded."""
    first = subtask_commands(WORLD, hand, np.array([*can_xy, CAN_HALF_HEIGHT]), 1)
    return np.concatenate((first, subtask_commands(WORLD, hand, station.spot(vacant), 2)))


def test_on_the_learned_motion_the_filter_changes_no_tick_of_the_teachers(hand, station):
    own = replace(WORLD, clearance=Clearance(learned_motion=True))
    system = clearance_filter(own, station)
    for can_xy, vacant in (((0.46, -0.07), "left"), ((0.60, 0.07), "right")):
        commands = commands_of(hand, station, can_xy, vacant)
        for posture, desired in itertools.pairwise(commands):
            inputs = dict(posture=posture, desired_posture=desired, alpha=[0.0])
            assert np.array_equal(evaluate(system, "filtered_posture", inputs), desired)


@pytest.mark.parametrize("cans", ["possible", "known"])
def test_a_hostile_command_does_not_bring_the_arm_into_desk_or_shelf(hand, station, cans):
    own = replace(WORLD, clearance=Clearance(cans=cans, learned_motion=True))
    system = clearance_filter(own, station)
    told = dict(obstacles=can_poses([0.6, 0.05, 0.05], station.spot("right"))) if cans == "known" else {}
    for goal in ([0.45, -0.05, 0.0], [*station.spot("left")[:2], 0.03]):
        target = np.append(hand.solve_ik(np.array(goal) + [0, 0, 0.02]), OPEN)
        target[:ARM_JOINTS] += 0.3 * (target - HOME)[:ARM_JOINTS]  # into it
        posture = HOME
        for _ in range(40):
            desired = posture + np.clip(target - posture, -0.15, 0.15)
            posture = evaluate(
                system, "filtered_posture", dict(posture=posture, desired_posture=desired, alpha=[0.0]) | told
            )
        checker = CollisionChecker(WORLD, gap=0.004)
        checker.set_scene((0.6, 0.05), "left")
        assert checker.first_touch(posture[:ARM_JOINTS]) is None
        assert np.abs(target - posture)[:ARM_JOINTS].max() > 0.02  # it would have gone on


_kept: list[ClearanceMap] = []


def _map() -> ClearanceMap:
    if not _kept:
        _kept.append(ClearanceMap(WORLD))
    return _kept[0]


def test_the_reach_is_that_of_the_stretched_arm(possible):
    # Joint 7 turns the hand, whose held can ends 0.06 m beyond the grasp frame; joint 1 carries two links of 0.31 m.
    assert np.all(np.diff(possible.reach) <= 0.0)
    assert possible.reach[6] == pytest.approx(0.19, abs=0.02)
    assert possible.reach[0] - possible.reach[2] == pytest.approx(0.31)
    assert possible.reach[2] - possible.reach[4] == pytest.approx(0.31)
    assert possible.reach[4] - possible.reach[6] == pytest.approx(0.175)


def shapes_by_link(plant, inspector):
    """Number of the link of each shape; hand and held can: that after the last."""
    links = {f"link_{j + 1}": j for j in range(ARM_JOINTS)}
    bodies = {
        s: plant.GetBodyFromFrameId(inspector.GetFrameId(s)) for s in inspector.GetAllGeometryIds(Role.kProximity)
    }
    return {shape: links.get(body.name(), ARM_JOINTS) for shape, body in bodies.items()}


@pytest.mark.parametrize("file", [None, ROOT / "sdf" / "iiwa.world.yaml"])
def test_no_joint_angles_let_the_links_meet(file):
    """Why the map leaves these pairs out: links against links, hand and held can against links 2 to 4."""
    builder = RobotDiagramBuilder(time_step=0.0)
    plant = builder.plant()
    add_models(plant, load_world(file), ("arm", "gripper", CANS[0]))
    plant.WeldFrames(plant.GetFrameByName("grasp"), can_body(plant, CANS[0]).body_frame(), X_GRASP_CAN)
    plant.Finalize()
    diagram = builder.Build()
    context, graph = diagram.CreateDefaultContext(), diagram.scene_graph()
    link = shapes_by_link(plant, graph.model_inspector())
    pairs = [(a, b) for a in link for b in link if link[a] + 3 <= link[b]]
    margin = np.append(np.full(ARM_JOINTS, LIMIT_MARGIN), [0.0, 0.0])  # no disturbance goes beyond
    lower, upper = plant.GetPositionLowerLimits() + margin, plant.GetPositionUpperLimits() - margin
    rng, closest = np.random.default_rng(0), np.inf
    for n in range(100):
        joints = rng.uniform(lower, upper) if n % 2 else np.where(rng.uniform(size=len(lower)) < 0.5, lower, upper)
        plant.SetPositions(plant.GetMyMutableContextFromRoot(context), joints)
        query = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(context))
        closest = min(closest, *(query.ComputeSignedDistancePairClosestPoints(a, b).distance for a, b in pairs))
    assert closest > 0.01


def test_the_hand_keeps_away_from_the_arms_own_foot(possible):
    """Folded to its limits the hand could meet base and link 1."""
    folded = np.deg2rad([-78.0, 105.0, 2.0, 105.0, 7.0, 90.0, -149.0])
    assert nearest(possible, folded, OPEN) < -0.02
    assert nearest(possible, HOME[:ARM_JOINTS], OPEN, within=0.14) == 0.14
    assert possible.from_foot(np.append(folded, OPEN)) == nearest(possible, folded, OPEN)
    assert possible.from_foot(HOME) == WITHIN
    # Another distance is none to the foot: the hand is in the desk.
    low = np.deg2rad([0.0, 100.0, 0.0, 40.0, 0.0, 0.0, 0.0])
    assert nearest(possible, low, OPEN) < 0.0
    assert possible.from_foot(np.append(low, OPEN)) == WITHIN


@pytest.mark.parametrize("cans", ["possible", "known"])
def test_a_gap_that_keeps_the_arm_from_home_is_refused(station, cans):
    own = replace(WORLD, clearance=Clearance(cans=cans, gap=0.13))
    with pytest.raises(
        InputError,
        match=r"gap 0\.13 m: at the initial posture the arm, or .* may be 0\.07\d m from desk, .* choose less",
    ):
        clearance_filter(own, station)
