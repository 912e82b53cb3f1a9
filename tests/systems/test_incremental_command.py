"""IncrementalCommand: by hand, tick by tick; home in spite of a constant; and as without it where there is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from systems.incremental_command import IncrementalCommand
from tests.systems.system_checks import fix

GAIN, MAX_STEP, LARGEST = 0.1, 0.35, 0.2  # of the posture regulator; step and offset, rad


def make(joints=1, **changes):
    size = joints + 1  # and a finger
    given = dict(initial_posture=np.zeros(size), joints=joints, lower=-4.0 * np.ones(size), upper=4.0 * np.ones(size))
    return IncrementalCommand(
        **(given | dict(max_step=np.full(joints, MAX_STEP), largest_offset=LARGEST, period=0.1) | changes)
    )


class Loop:
    """One joint and a finger: what each tick commands, and what is made of it further on."""

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
        """Measured postures from rest at `start` on; a tick makes `executed` of what the command is away from the arm.

        `offset`: by which the arm, or its sensor, is off where it is commanded to.
        """
        self.context.SetDiscreteState(0, [start - offset])
        posture, rows = start, [start]
        for _ in range(ticks):
            desired = (1.0 - GAIN) * posture
            command = self.tick(posture, desired)[0] if incremental else desired
            posture += executed * (command + offset - posture)
            rows.append(posture)
        return np.array(rows)


def test_by_hand_the_steps_add_up():
    """The arm rests at 1.0 although 0.95 was commanded: each tick goes on from what was commanded before."""
    loop = Loop()
    assert loop.tick(1.0, 0.95, alpha=0.0).tolist() == [0.95, 0.08]  # the network's: as it is
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.85, 0.08])
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.75, 0.08])
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.70, 0.08])  # an offset of 0.2, not of 0.25
    assert loop.tick(1.0, 0.90).tolist() == pytest.approx([0.70, 0.08])
    assert loop.tick(0.7, 0.63).tolist() == pytest.approx([0.63, 0.08])
    assert loop.tick(0.7, 0.95, alpha=0.49).tolist() == [0.95, 0.08]
    assert loop.tick(0.9, 0.81, alpha=0.5).tolist() == pytest.approx([0.86, 0.08])


def test_by_hand_it_goes_on_from_what_was_sent():
    """The filter has made 0.99 of 0.9."""
    loop = Loop()
    assert loop.tick(1.0, 1.0, alpha=0.0)[0] == 1.0
    assert loop.tick(1.0, 0.9, sent=0.99)[0] == pytest.approx(0.9)
    assert loop.tick(1.0, 0.9)[0] == pytest.approx(0.89)


def test_the_command_stays_within_the_limits_of_speed_and_position():
    loop = Loop()
    loop.tick(1.0, 0.8, alpha=0.0)
    assert loop.tick(1.0, 0.8)[0] == pytest.approx(0.65)  # 0.2 and the 0.2 of before are more than 0.35
    loop = Loop(lower=[-0.1, 0.0], upper=[0.1, 1.0])
    loop.tick(0.1, 0.1, alpha=0.0)
    assert loop.tick(0.1, 0.2)[0] == 0.1
    loop.tick(-0.1, -0.1, alpha=0.0)
    assert loop.tick(-0.1, -0.2)[0] == -0.1


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


@given(st.floats(-1.9, 1.9))
def test_an_arm_that_goes_where_it_is_commanded_to_goes_as_without(start):
    with_it, without = (Loop().home(start, 60, incremental=given) for given in (True, False))
    assert with_it == pytest.approx(without, abs=1e-12)


@given(st.floats(0.01, 1.0), st.floats(0.01, 0.99))
def test_its_ideal_loop_is_stable_for_every_servo(executed, gain):
    """z^2 - (2 - executed) z + 1 - executed + executed gain, see the class."""
    assert np.abs(np.roots([1.0, executed - 2.0, 1.0 - executed + executed * gain])).max() < 1.0


def test_a_held_arm_does_not_wind_it_up():
    """However long it is held: when it is let go its step is the regulator's and the largest offset, not more."""
    loop = Loop()
    commands = [loop.tick(1.0, 0.9)[0] for _ in range(50)]
    assert commands[-1] == pytest.approx(0.9 - LARGEST)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(joints=3, initial_posture=[0.0, 0.0]), "joints is 3.*at most 2"),
        (dict(period=0.0), "period is 0.0.*greater than 0"),
        (dict(max_step=[-0.1]), "max_step is .*at least 0"),
        (dict(largest_offset=0.0), "largest_offset is 0.0.*greater than 0"),
        (dict(lower=[0.0, 2.0], upper=[0.0, 1.0]), "lower"),
        (dict(initial_posture=[np.nan, 0.0]), "initial_posture is .*nan.*finite"),
    ],
)
def test_bad_arguments(changes, named):
    with pytest.raises(ValueError, match=named):
        make(**changes)
