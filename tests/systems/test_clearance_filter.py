"""ClearanceFilter: the barrier by hand, the nearest step, the proof of a step, and what passes untouched."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from systems import clearance_filter
from systems.clearance_filter import WITHIN
from tests.systems.clearance_fakes import Post, ToldWall, Walls, make_filter
from tests.systems.system_checks import evaluate

AHEAD = ((-1.0, 0.0), -0.1)  # a wall at 0.1 m in the first coordinate
GAP, LEAST, RATE = 0.01, 0.005, 0.3  # the defaults


def filtered(walls, posture, desired, alpha=1.0, output="filtered_posture", **changes):
    inputs = dict(posture=[*posture, 0.03], desired_posture=[*desired, 0.08], alpha=[alpha])
    return evaluate(make_filter(walls, **changes), output, inputs)


def test_barrier_by_hand():
    # 0.1 m before the wall, 0.09 above the gap: a tick may use up 0.3 of that; along the wall the step stays.
    np.testing.assert_allclose(filtered(Walls(AHEAD), [0.0, 0.0], [0.08, 0.05]), [0.027, 0.05, 0.08], atol=1e-6)
    np.testing.assert_allclose(
        filtered(Walls(AHEAD), [0.0, 0.0], [0.08, 0.0], gap=0.02, rate=0.5), [0.04, 0.0, 0.08], atol=1e-6
    )


def test_the_change_is_measured_by_how_far_the_joints_can_move_the_arm():
    # Across the wall 0.027 of 0.075 are left. What is taken away is in the ratio of 0.6 / 2^2 to 0.8 / 1^2, not 0.6 to
    # 0.8: the joint that moves the arm less gives way more.
    walls = Walls(((-0.6, -0.8), -0.1), reach=(2.0, 1.0))
    np.testing.assert_allclose(filtered(walls, [0.0, 0.0], [0.045, 0.06])[:2], [0.035137, 0.007397], atol=1e-6)


def test_where_little_of_the_way_is_left_the_reach_counts_twice():
    # Across the wall 0.027 of 0.5 are left. With the weights 4 and 1, (0.203, -0.118), 5 % of the way along the step is
    # made; so it is 16 and 1.
    walls = Walls(((-0.6, -0.8), -0.1), reach=(2.0, 1.0))
    np.testing.assert_allclose(filtered(walls, [0.0, 0.0], [0.3, 0.4])[:2], [0.27322, -0.17117], atol=1e-5)
    # With more of it along the wall nearly all is made: 4 and 1, as ever.
    np.testing.assert_allclose(filtered(walls, [0.0, 0.0], [0.33, -0.06])[:2], [0.304726, -0.194795], atol=1e-5)


def test_the_other_weight_does_not_stop_the_arm():
    # At the gap. With the weights 4 and 1 a quarter of the way is left, with 16 and 1 nothing.
    walls = Walls(((-1.6, -0.08), -GAP), reach=(2.0, 1.0))
    got = filtered(walls, [0.0, 0.0], [0.1, 0.08])[:2]
    assert -1.6 * got[0] - 0.08 * got[1] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(got, [-0.00297, 0.05941], atol=1e-5)


def test_the_other_weight_keeps_the_margin_that_the_first_one_kept():
    # 5 mm nearer than gap and margin ask for: 0.3 of that come back, with a tenth of the way along the step.
    normal = np.array([-0.493, -0.082])
    walls = Walls((normal, -0.0554), reach=(2.0, 1.0), margin=0.05)
    got = filtered(walls, [0.0, 0.0], [0.1, 0.1])[:2]
    assert normal @ got == pytest.approx(0.3 * 0.0046, abs=1e-6)


def test_where_the_second_solution_fails_the_first_one_holds(monkeypatch):
    solver, calls = clearance_filter.ClarabelSolver(), []

    def solve(program):
        calls.append(program)
        return solver.Solve(program) if len(calls) == 1 else SimpleNamespace(is_success=lambda: False)

    monkeypatch.setattr(clearance_filter, "ClarabelSolver", lambda: SimpleNamespace(Solve=solve))
    walls = Walls(((-0.6, -0.8), -0.1), reach=(2.0, 1.0))
    np.testing.assert_allclose(filtered(walls, [0.0, 0.0], [0.3, 0.4])[:2], [0.20281, -0.11836], atol=1e-4)
    assert len(calls) == 2


def test_a_margin_is_kept_beyond_the_gap_and_the_proof_does_without():
    # 0.07 beyond gap and margin: 0.3 of that. The margin itself may be lost where a step is farther than what is seen.
    np.testing.assert_allclose(
        filtered(Walls(AHEAD, margin=0.02), [0.0, 0.0], [0.08, 0.05]), [0.021, 0.05, 0.08], atol=1e-6
    )
    step = filtered(Walls(AHEAD, margin=0.02), [-0.1, 0.0], [0.3, 0.0])[0] + 0.1
    assert 0.2 - LEAST - 1.1e-4 < step < 0.2 - LEAST + 1e-9


def test_a_margin_that_stops_the_arm_is_given_up():
    # Where gap and margin end there is no way on: what the gap leaves is used. Along the wall there is one.
    walls = Walls(AHEAD, margin=0.02)
    np.testing.assert_allclose(filtered(walls, [0.07, 0.0], [0.12, 0.0])[:2], [0.07 + 0.3 * 0.02, 0.0], atol=1e-6)
    np.testing.assert_allclose(filtered(walls, [0.07, 0.0], [0.12, 0.05])[:2], [0.07, 0.05], atol=1e-6)
    # Nearer than the margin asks for it comes away from the wall, if that is on its way; else it goes on.
    np.testing.assert_allclose(filtered(walls, [0.08, 0.0], [0.08, 0.05])[:2], [0.08 - 0.3 * 0.01, 0.05], atol=1e-5)
    np.testing.assert_allclose(filtered(walls, [0.08, 0.0], [0.082, 0.0])[:2], [0.082, 0.0], atol=1e-12)


def test_nearer_than_the_gap_it_is_pushed_back():
    # 4 mm before the wall: 6 mm below the gap, 0.3 of them a tick.
    np.testing.assert_allclose(filtered(Walls(AHEAD), [0.096, 0.0], [0.12, 0.0])[0], 0.096 - 0.0018, atol=1e-6)


@pytest.mark.parametrize("desired", [[-0.2, 0.3], [0.0269, 0.0], [0.0, 0.0]])
def test_a_step_that_keeps_the_distance_passes_to_the_bit(desired):
    posture = np.array([0.0, 0.0])
    assert np.array_equal(filtered(Walls(AHEAD), posture, desired)[:2], posture + (np.array(desired) - posture))


def test_the_learned_motion_passes_to_the_bit():
    assert np.array_equal(filtered(Walls(AHEAD), [0.0, 0.0], [0.3, 0.1], alpha=0.49), [0.3, 0.1, 0.08])
    assert filtered(Walls(AHEAD), [0.0, 0.0], [0.3, 0.1], alpha=0.5)[0] < 0.1


def test_the_learned_motion_is_filtered_where_that_is_asked_for():
    asked = filtered(Walls(AHEAD), [0.0, 0.0], [0.3, 0.1], alpha=0.0, learned_motion=True)
    np.testing.assert_allclose(asked, [0.027, 0.1, 0.08], atol=1e-6)


def test_the_clearance_is_that_of_the_posture():
    assert filtered(Walls(AHEAD), [0.04, 0.0], [0.0, 0.0], output="clearance") == pytest.approx(0.06)
    assert filtered(Walls(AHEAD), [-0.9, 0.0], [0.0, 0.0], output="clearance") == WITHIN


def test_the_map_is_told_of_obstacles():
    inputs = dict(posture=[0.0, 0.0, 0.0], desired_posture=[0.3, 0.0, 0.0], alpha=[1.0])
    for place in (0.1, 0.05):
        got = evaluate(make_filter(ToldWall()), "filtered_posture", inputs | dict(obstacles=[place]))
        assert got[0] == pytest.approx(0.3 * (place - GAP), abs=1e-6)


def test_a_wall_that_the_gradient_does_not_see_cuts_the_step():
    # At its beginning the wall is 0.2 m away, farther than WITHIN. The arm moves as fast as its reach says, so that the
    # proof goes up to the least distance itself.
    step = filtered(Walls(AHEAD), [-0.1, 0.0], [0.3, 0.0])[:2] - [-0.1, 0.0]
    assert 0.2 - LEAST - 1.1e-4 < step[0] < 0.2 - LEAST + 1e-9
    assert step[1] == 0.0


def test_what_overlaps_has_no_say_in_the_proof():
    # Inside a wall the arm is pushed out of it, the whole step that the barrier asks for.
    assert filtered(Walls(AHEAD), [0.12, 0.0], [0.2, 0.0])[0] == pytest.approx(0.12 - 0.3 * 0.03, abs=1e-6)


def test_between_two_walls_the_arm_comes_nearer_to_neither():
    between = Walls(((-1.0, 0.0), -0.1), ((1.0, 0.0), 0.096))  # walls 4 mm apart: each pushes it into the other
    got = filtered(between, [0.098, 0.0], [0.2, 0.02])
    assert got[0] == pytest.approx(0.098, abs=1e-6)
    assert 0.0 < got[1] <= 0.02  # along them it goes on


def test_where_the_solver_fails_the_arm_holds(monkeypatch):
    failed = SimpleNamespace(is_success=lambda: False)
    monkeypatch.setattr(clearance_filter, "ClarabelSolver", lambda: SimpleNamespace(Solve=lambda program: failed))
    np.testing.assert_array_equal(filtered(Walls(AHEAD), [0.05, 0.02], [0.2, 0.1]), [0.05, 0.02, 0.08])


@pytest.mark.parametrize("distance", [1e-5, 1e-4, 1e-3, 0.004, 0.005, 0.00502])
def test_from_just_before_contact_it_comes_away(distance):
    posture = np.array([0.1 - distance, 0.0])
    for _ in range(15):
        posture = filtered(Walls(AHEAD), posture, posture + [-0.02, 0.0])[:2]
    assert 0.1 - posture[0] > 0.05


def test_nearer_than_the_least_distance_it_does_not_stand_for_want_of_proof():
    """4 mm before the wall, along it: a proof that keeps 0.9 of it gets a tenth of the way, of 2e-4 m a piece."""
    got = filtered(Walls(AHEAD), [0.096, 0.0], [0.096, 0.2])
    assert got[1] > 0.1


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-4, 0.0049), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_property_nearer_than_the_least_distance_half_of_it_is_kept(distance, x, y):
    walls, posture = Walls(((-1.0, 0.0), -distance)), np.zeros(2)
    for _ in range(10):
        before = distance - posture[0]
        posture = filtered(walls, posture, np.clip(posture + [x, y], -1, 1))[:2]
        assert distance - posture[0] >= min(LEAST, 0.5 * before) - 1e-9


def test_the_limits_hold():
    # 0.3 of 0.31 m would be too fast; the wall pushes, the joint's limit does not give way.
    assert filtered(Walls(((-1.0, 0.0), 0.3)), [0.0, 0.0], [0.0, 0.0], max_step=np.full(2, 0.05))[0] == pytest.approx(
        0.0, abs=1e-4
    )
    pushed = filtered(Walls(((1.0, 0.0), 0.0)), [-0.05, 0.0], [-0.3, 0.0], lower=np.array([-1.0, -0.2, -1.0]))
    assert pushed[0] == pytest.approx(-0.05 + 0.3 * 0.06, abs=1e-6)


corridor = st.floats(0.012, 0.14), st.floats(0.012, 0.14), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)


@settings(max_examples=60, deadline=None)
@given(*corridor)
def test_property_the_step_is_the_nearest_that_keeps_every_distance(right, left, x, y):
    walls = Walls(((-1.0, 0.0), -right), ((1.0, 0.0), -left))
    got = filtered(walls, [0.0, 0.0], [x, y])[:2]
    wanted = np.clip(x, -RATE * (left - GAP), RATE * (right - GAP))
    np.testing.assert_allclose(got, [wanted, y], atol=2e-5)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 2 * np.pi), st.floats(0.006, 0.2), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_property_no_command_comes_nearer_than_the_least_distance(angle, distance, x, y):
    normal = np.array([np.cos(angle), np.sin(angle)])
    walls, posture = Walls((normal, -distance)), np.zeros(2)
    for _ in range(20):
        posture = filtered(walls, posture, np.clip(posture + [x, y], -1, 1))[:2]
        assert normal @ posture + distance >= min(LEAST, 0.9 * distance) - 1e-9


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 2 * np.pi), st.floats(0.0051, 0.1), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_property_a_post_that_curves_away_from_the_gradient_is_not_run_into(angle, distance, x, y):
    """A round obstacle of 3 cm: across it the linear barrier sees nothing, and the proof has to."""
    post = Post(0.03)
    posture = (post.radius + distance) * np.array([np.cos(angle), np.sin(angle)])
    for _ in range(10):
        posture = filtered(post, posture, np.clip(posture + [x, y], -1, 1))[:2]
        assert np.linalg.norm(posture) - post.radius >= min(LEAST, 0.9 * distance) - 1e-9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(gap=0.0), "gap is 0.0.*greater than 0"),
        (dict(gap=0.2), "gap 0.2.*least < gap < 0.15"),
        (dict(least=0.02), "least is 0.02.*least < gap"),
        (dict(rate=1.5), "rate 1.5.*rate <= 1"),
        (dict(joints=4), "joints is 4.*at most 3"),
        (dict(max_step=[-1.0, 1.0]), "max_step.*at least 0"),
        (dict(lower=np.ones(3)), "lower is .*swap or widen"),
    ],
)
def test_error_names_value_limit_and_remedy(changes, message):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        make_filter(Walls(AHEAD), **changes)


def test_a_joint_without_reach_is_an_error():
    with pytest.raises(ValueError, match=r"map.reach is \[1. 0.\]; of each joint it must be greater than 0"):
        make_filter(Walls(AHEAD, reach=(1.0, 0.0)))
