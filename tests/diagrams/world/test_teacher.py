"""The teacher: what is taught, how the arm is pushed off its path, and one demonstration in physics."""

import numpy as np

from diagrams.world.names import CAN_HALF_HEIGHT
from diagrams.world.teacher import Teacher, setups
from diagrams.world.trajectory import DWELL_DEVIATION, FREE_DEVIATION, SUBTASK_STEPS, deviations, subtask_waypoints


def test_all_positions_times_both_spots(world):
    given = setups(world, 0)
    assert len(given) == 200
    assert len({(setup.grid_index, setup.vacant) for setup in given}) == 200
    assert [setup.name for setup in given] == [f"demo_{n}" for n in range(200)]
    assert setups(world, 0) == given
    assert [setup.turn for setup in setups(world, 1)] != [setup.turn for setup in given]


def test_deviations_are_smooth_bounded_and_none_at_the_cans(world, hand):
    for subtask, steps in enumerate(SUBTASK_STEPS, start=1):
        waypoints = subtask_waypoints(world, hand, np.array([*world.grid.position(4, 5), CAN_HALF_HEIGHT]), subtask)
        near, far = waypoints[2].tick, waypoints[-3].tick
        rows = np.array([deviations(waypoints, steps, np.random.default_rng([0, n])) for n in range(20)])
        assert np.array_equal(rows[3], deviations(waypoints, steps, np.random.default_rng([0, 3])))
        assert not np.array_equal(rows[3], rows[4])
        size = np.abs(rows[..., :7]).max(axis=(0, 2))
        assert size.max() <= FREE_DEVIATION
        assert size.max() > 0.9 * FREE_DEVIATION
        assert size[near - 1 : far].max() == 0.0
        assert max(size[: waypoints[1].tick].max(), size[waypoints[-2].tick :].max()) <= DWELL_DEVIATION + 1e-12
        assert not rows[..., 7].any()
        assert np.abs(np.diff(rows, axis=1)).max() < np.deg2rad(1.0)  # a tick


def test_one_demonstration(world, hand):
    teacher, setup = Teacher(world), setups(world, 0)[3]
    given = teacher.demonstrate(setup)
    assert given.success
    assert (given.grid_index, given.vacant, given.split) == ((0, 1), "right", "valid")
    assert np.array_equal(given.can_xy, world.grid.position(0, 1))
    assert given.rgb.shape == (sum(SUBTASK_STEPS), 112, 112, 3)
    actions, pushed = teacher.commands(setup)
    assert np.array_equal(given.actions, actions)  # the motion to learn is that without the deviations
    assert np.abs(given.posture[0] - world.initial_posture).max() < 1e-6
    off = np.abs(given.posture[1:, :7] - actions[:-1, :7]).max(axis=1)  # what the arm was pushed off by, and its lag
    assert np.deg2rad(1.0) < off.max() < np.deg2rad(4.0)
    assert off[[*range(76, 98), *range(161 + 105, 161 + 135)]].max() < np.deg2rad(1.0)  # a finger's breadth from a can
    assert np.array_equal(given.posture[1:, 7], actions[:-1, 7])  # the opening is the commanded one
    assert min(hand.margin(joints) for joints in (actions + pushed)[:, :7]) >= np.deg2rad(8.0)
