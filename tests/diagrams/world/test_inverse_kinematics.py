"""Inverse kinematics, the teacher's commands, and checker: of every position that is ever taught."""

import numpy as np
import pytest

from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import TILT_DEG
from diagrams.world.names import CAN_HALF_HEIGHT, SPOTS
from diagrams.world.station import arm_plant, controller_limits
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, HOVER, subtask_commands
from models.errors import InputError

MARGIN = np.deg2rad(8.0)


def goals(world, station):
    """(subtask, centre of the can) of all 100 positions and both spots."""
    cells = [(i, j) for i in range(world.grid.count) for j in range(world.grid.count)]
    yield from ((1, np.array([*world.grid.position(*cell), CAN_HALF_HEIGHT])) for cell in cells)
    yield from ((2, station.spot(name)) for name in SPOTS)


@pytest.fixture(scope="module")
def taught(world, station, hand):
    """(subtask, centre, commands) of all of them."""
    return [
        (subtask, centre, subtask_commands(world, hand, centre, subtask)) for subtask, centre in goals(world, station)
    ]


@pytest.mark.parametrize("position", [[0.44, -0.09, 0.06], [0.62, 0.09, 0.2], [0.25, 0.43, 0.15]])
def test_solution_puts_the_hand_there(hand, position):
    position = np.array(position)
    joints = hand.solve_ik(position)
    assert hand.grasp_position(joints) == pytest.approx(position, abs=1e-5)
    plant = arm_plant(World())
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.append(joints, [0.0, 0.0]))
    R = plant.GetFrameByName("grasp").CalcPoseInWorld(context).rotation().matrix()
    assert R[2, 2] == pytest.approx(-np.sin(np.deg2rad(TILT_DEG)), abs=2e-3)  # leaning outwards by 5 deg
    assert R[2, 0] == pytest.approx(0.0, abs=2e-3)  # the fingers are level
    assert R[0, 2] * position[1] == pytest.approx(R[1, 2] * position[0], abs=2e-3)  # and lean along the arm


@pytest.mark.parametrize("position", [[1.5, 0.0, 0.1], [0.05, 0.0, 0.05], [0.5, 0.0, 1.5]])
def test_out_of_reach_is_an_error_that_names_the_place(hand, position):
    with pytest.raises(InputError, match=rf"cannot reach \[{position[0]}, "):
        hand.solve_ik(np.array(position))


def test_margin_is_the_distance_to_the_nearest_limit(hand):
    assert hand.margin(np.zeros(7)) == pytest.approx(np.deg2rad(45))
    joints = np.zeros(7)
    joints[5] = np.deg2rad(92)
    assert hand.margin(joints) == pytest.approx(np.deg2rad(-2))


def test_every_command_has_margin_to_the_joint_limits(taught, hand):
    assert len(taught) == 102
    worst = {tuple(centre): min(hand.margin(row[:7]) for row in rows) for _, centre, rows in taught}
    assert min(worst.values()) >= MARGIN


def test_hand_grasps_at_every_position(taught, hand):
    for _, centre, rows in taught:
        heights = np.array([hand.grasp_position(row[:7]) for row in rows[60:130:2]])
        lowest = heights[np.argmin(heights[:, 2])]
        assert lowest == pytest.approx(centre + [0, 0, GRASP_ABOVE_CENTRE], abs=0.005)


def test_lengths_are_those_of_the_paper(taught):
    assert {(subtask, len(rows)) for subtask, _, rows in taught} == {(1, 161), (2, 192)}


def test_commands_start_and_end_at_the_initial_posture(taught, world):
    for subtask, _, rows in taught:
        # A dwell at both ends, from which the network learns to wait.
        for row in (*rows[:12], *rows[-15:]):
            assert row[:7] == pytest.approx(world.initial_posture[:7], abs=1e-9)
        opening = {1: (world.opening, world.closed_opening), 2: (world.closed_opening, world.opening)}[subtask]
        assert (rows[0, 7], rows[-1, 7]) == opening
        assert np.count_nonzero(np.diff(rows[:, 7])) == 1


def test_commands_are_continuous_and_slower_than_the_joints_may(taught, station, world):
    _, _, speed = controller_limits(station)
    for _, _, rows in taught:
        steps = np.abs(np.diff(rows[:, :7], axis=0))
        assert np.all(steps <= 0.8 * speed[:7] * world.timing.period)
        assert np.abs(np.diff(rows[:, :7], 2, axis=0)).max() < np.deg2rad(3.5)  # a tick^2: no jerk to spill the can


def test_hand_comes_down_from_above(taught, hand):
    """Within a can's width of its goal, the hand moves straight up and down."""
    for _, centre, rows in taught[::7]:
        positions = np.array([hand.grasp_position(row[:7]) for row in rows])
        near = positions[:, 2] < centre[2] + 0.8 * HOVER
        assert np.linalg.norm(positions[near, :2] - centre[:2], axis=1).max() < 0.006


@pytest.fixture(scope="module")
def checker(world):
    return CollisionChecker(world)


def test_home_is_clear(checker, world):
    for can in ((0.53, 0.0), None):
        checker.set_scene(can, "left")
        assert checker.first_touch(world.initial_posture[:7]) is None


def test_hand_in_the_desk_touches_it(checker, hand):
    checker.set_scene((0.60, -0.08), "left")
    assert checker.first_touch(hand.solve_ik(np.array([0.5, 0.05, 0.005]))) == "desk"
    assert checker.first_touch(hand.solve_ik(np.array([0.5, 0.05, 0.12]))) is None


def test_hand_at_a_can_touches_it(checker, hand):
    checker.set_scene((0.5, 0.0), "left")
    assert checker.first_touch(hand.solve_ik(np.array([0.5, 0.03, 0.07]))) == "can_to_pick"
    checker.set_scene((0.6, 0.0), "left")
    assert checker.first_touch(hand.solve_ik(np.array([0.5, 0.03, 0.07]))) is None


def test_fingers_are_as_far_open_as_they_are(checker, hand):
    # The can's edge is 26.5 mm from its axis, the open fingers reach 40 mm and their thickness from the hand's.
    beside = hand.solve_ik(np.array([0.5, -0.085, 0.06]))
    for opening, touched in ((0.08, "can_to_pick"), (0.03, None)):
        checker.set_scene((0.5, 0.0), "left", opening)
        assert checker.first_touch(beside) == touched
    # On the can that they hold they are as wide as it.
    checker.set_scene(None, "left")
    assert checker._plant.GetPositions(checker._plant_context, checker._gripper).tolist() == [0.0265, 0.0265]


def test_held_can_counts_as_the_hand(checker, hand, station):
    above = hand.solve_ik(station.spot("left") + [0, 0, 0.06])
    low = hand.solve_ik(station.spot("left") + [0, 0, 0.01 - 0.015])
    checker.set_scene(None, "left")
    assert checker.first_touch(above) is None
    assert checker.first_touch(low) == "shelf"
    checker.set_scene(None, "right")  # the other can stands there
    assert checker.first_touch(low) in ("shelf", "can_on_shelf")
    assert checker.first_touch(above) == "can_on_shelf"


def test_path_through_something_is_seen(checker, hand, world):
    home = world.initial_posture[:7]
    checker.set_scene((0.5, 0.0), "left")
    touches = checker.path_touches
    assert touches(home, hand.solve_ik(np.array([0.6, -0.05, 0.25]))) is None
    beyond = hand.solve_ik(np.array([0.5, -0.11, 0.06])), hand.solve_ik(np.array([0.5, 0.11, 0.06]))
    assert checker.first_touch(beyond[0]) is None
    assert checker.first_touch(beyond[1]) is None
    assert touches(*beyond) == "can_to_pick"
