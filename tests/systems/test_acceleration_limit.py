"""AccelerationLimit: by hand, tick by tick; and on the whole way of a joint."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from systems.acceleration_limit import AccelerationLimit
from tests.systems.system_checks import fix
from tests.systems.test_incremental_command import Loop as IncrementalLoop

GROWTH = 0.14  # rad a tick


def make(**changes):
    given = dict(joints=2, initial_posture=[1.0, -1.0, 0.08], acceleration=14.0, period=0.1)
    return AccelerationLimit(**(given | changes))


class Ticks:
    def __init__(self):
        self.system = make()
        self.context = self.system.CreateDefaultContext()

    def __call__(self, posture, step, alpha=1.0):
        """The step (2,) that is left of `step` (2,) in this tick."""
        posture, step = np.array(posture), np.array(step)
        inputs = dict(posture=[*posture, 0.03], desired_posture=[*(posture + step), 0.08], alpha=[alpha])
        fix(self.system, self.context, inputs)
        limited = self.system.get_output_port().Eval(self.context)
        self.context.SetDiscreteState(self.system.EvalUniquePeriodicDiscreteUpdate(self.context))
        assert limited[2] == 0.08  # the fingers pass
        return limited[:2] - posture


def test_by_hand_the_step_grows_from_rest_and_by_what_the_joint_has_moved():
    tick = Ticks()
    assert tick([1.0, -1.0], [-0.3, 0.1]) == pytest.approx([-0.14, 0.1])
    assert tick([0.9, -0.9], [-0.3, 0.3]) == pytest.approx([-0.24, 0.24])  # moved by 0.1: 0.1 + 0.14
    assert tick([0.7, -0.65], [-0.3, 0.3]) == pytest.approx([-0.3, 0.3])
    assert tick([0.8, -0.65], [-0.3, 0.3]) == pytest.approx([-0.24, 0.14])  # thrown back, and stopped


def test_the_learned_motion_passes_to_the_bit_and_what_it_moved_counts():
    tick = Ticks()
    assert tick([1.0, -1.0], [0.5, 0.25], alpha=0.49).tolist() == [0.5, 0.25]
    assert tick([1.3, -0.9], [0.5, -0.5], alpha=0.5) == pytest.approx([0.44, -0.24])


@pytest.mark.parametrize("constant", [-0.2, 0.0, 0.13, 0.15, 0.2])
def test_what_is_carried_on_from_the_last_command_is_not_cut(constant):
    """IncrementalCommand stands behind it: a sag as large as the limit, which alone lets the arm drift, comes home."""
    limit, incremental = Ticks(), IncrementalLoop(max_step=[0.4])
    posture = 1.0
    for _ in range(300):
        step = limit([posture, 0.0], [-0.1 * posture, 0.0])[0]
        command = incremental.tick(posture, posture + step)[0]
        posture += 0.9 * (command + constant - posture)
    assert posture == pytest.approx(0.0, abs=1e-6)


def test_a_step_within_the_bound_passes_to_the_bit():
    tick, step = Ticks(), [0.139, -0.1]
    posture = np.array([1.0, -1.0])
    assert np.array_equal(tick(posture, step), posture + step - posture)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2), st.floats(0.05, 1.0))
def test_property_the_way_home_is_as_short_and_no_tick_is_much_faster_than_the_one_before(start, executed):
    tick, rows = Ticks(), [np.array(start)]
    tick(start, [0.0, 0.0])
    for _ in range(120):
        step = np.clip(-0.1 * rows[-1], -0.3, 0.3)
        rows.append(rows[-1] + executed * tick(rows[-1], step))
    moved = np.abs(np.diff(rows, axis=0))
    assert np.all(np.diff(np.abs(rows), axis=0) <= 0.0)  # each joint goes home, and never back
    assert np.all(np.diff(moved, axis=0, prepend=0.0) <= GROWTH + 1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (dict(acceleration=0.0), "acceleration is 0.0"),
        (dict(acceleration=float("nan")), "acceleration is nan"),
        (dict(period=-0.1), "period is -0.1"),
        (dict(joints=4), "joints is 4"),
        (dict(initial_posture=[0.0, float("inf"), 0.0]), "initial_posture is"),
    ],
)
def test_bad_arguments(changes, words):
    with pytest.raises(ValueError, match=words):
        make(**changes)
