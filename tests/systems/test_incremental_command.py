"""IncrementalCommand: by hand, tick by tick; home in spite of a constant; and as without it where there is none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from systems.incremental_command import IncrementalCommand
from tests.systems.system_checks import fix

GAIN, MAX_STEP, LARGEST = 0.1, 0.35, 0.2  # of the posture regulator; step and offset, rad
LOOPS = settings(max_examples=30, deadline=None)


def make(**changes):
    given = dict(posture_size=2, joints=1, lower=[-4.0, 0.0], upper=[4.0, 1.0], period=0.1)  # a joint and a finger
    return IncrementalCommand(**(given | dict(max_step=[MAX_STEP], largest_offset=LARGEST) | changes))


class Loop:
    """What each tick commands, and what is made of it further on."""

    def __init__(self, **changes):
        self.system = make(**changes)
        self.context = self.system.CreateDefaultContext()

    def tick(self, posture, desired, alpha=1.0, sent=None):
        """The command (2,) of a tick; `sent`: joint of what the arm is told instead of it."""
        fix(self.system, self.context, dict(posture=[posture, 0.03], desired_posture=[desired, 0.08], alpha=[alpha]))
        command = self.system.get_output_port().Eval(self.context)
        fix(self.system, self.context, dict(sent_posture=command if sent is None else [sent, 0.08]))
        self.context.SetDiscreteState(self.system.EvalUniquePeriodicDiscreteUpdate(self.context))
        return command

    def home(self, start, ticks, offset=0.0, executed=1.0, incremental=True):
        """Measured postures from `start` on; a tick makes `executed` of what the command is away from the arm.

        `offset`: by which the arm, or its sensor, is off where it is commanded to.
        """
        posture, rows = start, [start]
        for _ in range(ticks):
            desired = (1.0 - GAIN) * posture
            command = self.tick(posture, desired)[0] if incremental else desired
            posture += executed * (command + offset - posture)
            rows.append(posture)
        return np.array(rows)


def test_by_hand_the_steps_add_up_from_the_first_of_a_way_home_on():
    """The arm rests at 1.0 whatever is commanded; each tick but the first goes on from what was commanded before."""
    loop = Loop()
    assert loop.tick(1.0, 0.90).tolist() == [0.90, 0.08]  # the first tick of all
    assert loop.tick(1.0, 0.95, alpha=0.0).tolist() == [0.95, 0.08]  # the network's: as it is
    assert loop.tick(1.0, 0.90).tolist() == [0.90, 0.08]
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.80, 0.08])
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.70, 0.08])
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.70, 0.08])  # an offset of 0.2, not of 0.3
    assert loop.tick(0.6, 0.54).tolist() == pytest.approx([0.64, 0.08])
    assert loop.tick(0.6, 0.95, alpha=0.49).tolist() == [0.95, 0.08]
    assert loop.tick(0.9, 0.81, alpha=0.5).tolist() == [0.81, 0.08]


def test_by_hand_it_goes_on_from_what_was_sent():
    """The filter has made 0.99 of 0.9."""
    loop = Loop()
    assert loop.tick(1.0, 0.9, sent=0.99)[0] == 0.9
    assert loop.tick(1.0, 0.9)[0] == pytest.approx(0.89)


def test_the_command_stays_within_the_limits_of_speed_and_position():
    loop = Loop()
    assert [loop.tick(1.0, 0.8)[0] for _ in range(2)] == pytest.approx([0.8, 0.65])  # not 0.6: 0.35 at most
    for side in (-1.0, 1.0):
        loop = Loop(lower=[-0.1, 0.0], upper=[0.1, 1.0])
        commands = [loop.tick(0.1 * side, 0.2 * side, sent=0.1 * side)[0] for _ in range(2)]
        assert commands == [0.2 * side, 0.1 * side]  # what it passes, others have limited


@LOOPS
@given(st.floats(-0.19, 0.19), st.floats(0.2, 1.0), st.floats(-2.0, 2.0))
def test_a_constant_does_not_keep_it_from_home(offset, executed, start):
    """Without it the arm rests ten offsets from home: test_posture_regulator.py."""
    assert abs(Loop().home(start, 400, offset, executed)[-1]) < 1e-6


@pytest.mark.parametrize(("incremental", "rests"), [(True, 0.0), (False, 0.5)])
def test_where_the_arm_rests_by_hand(incremental, rests):
    """An offset of 0.05, of which each tick makes up all."""
    assert Loop().home(1.0, 300, 0.05, 1.0, incremental)[-1] == pytest.approx(rests, abs=1e-6)


def test_of_a_larger_offset_the_rest_remains():
    """0.25, of which 0.2 is made up for: the arm rests ten times 0.05 from home."""
    assert Loop().home(0.0, 400, 0.25)[-1] == pytest.approx(0.5, abs=1e-6)


@LOOPS
@given(st.floats(-1.9, 1.9))
def test_an_arm_that_goes_where_it_is_commanded_to_goes_as_without(start):
    with_it, without = (Loop().home(start, 60, incremental=given) for given in (True, False))
    assert with_it == pytest.approx(without, abs=1e-12)


@LOOPS
@given(st.floats(0.05, 1.0), st.floats(-0.19, 0.19))
def test_its_loop_is_that_of_the_docstring(executed, start):
    """m'' = (2 - s - s K) m' - (1 - s) m, stable, while nothing is clamped."""
    trace, product = 2.0 - executed - executed * GAIN, 1.0 - executed
    rows = Loop(max_step=[4.0]).home(start, 40, executed=executed)
    assert rows[2:] == pytest.approx(trace * rows[1:-1] - product * rows[:-2], abs=1e-12)
    assert np.abs(np.roots([1.0, -trace, product])).max() < 1.0


def test_a_held_arm_does_not_wind_it_up():
    """However long it is held: when it is let go its step is the regulator's and the largest offset, not more."""
    loop = Loop()
    commands = [loop.tick(1.0, 0.9)[0] for _ in range(50)]
    assert commands[-1] == pytest.approx(0.9 - LARGEST)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(joints=3), "joints is 3.*at most 2"),
        (dict(period=0.0), "period is 0.0.*greater than 0"),
        (dict(max_step=[-0.1]), "max_step is .*at least 0"),
        (dict(largest_offset=0.0), "largest_offset is 0.0.*greater than 0"),
        (dict(lower=[0.0, 2.0], upper=[0.0, 1.0]), "lower"),
    ],
)
def test_bad_arguments(changes, named):
    with pytest.raises(ValueError, match=named):
        make(**changes)
