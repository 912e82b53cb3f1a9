"""What counts as success, on hand-made runs."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagrams.episodes.episode import Outcome
from diagrams.episodes.switching import SWITCHING_FAILURES, Switching
from diagrams.world.task import TaskMonitor, tilt

PERIOD = 0.1
TICKS = 260


def switching_of(alpha, active, at_home, disturbed, period):
    """Of a whole run: `alpha`, `active`, `at_home` (ticks,) arrays."""
    switching = Switching(disturbed, period)
    for tick in zip(alpha.tolist(), active.tolist(), at_home.tolist(), strict=True):
        switching.see(*tick)
    return switching


def run(onset=50, end=68, high=(52, 121), home=100, disturbed=True, false_alarm=None):
    """Switching of a run: disturbed in [onset, end), alpha 1 in `high`, else 0.02, at home from `home` on."""
    ticks = np.arange(TICKS)
    active = (ticks >= onset) & (ticks < end) if onset is not None else np.zeros(TICKS, bool)
    alpha = np.where((ticks >= high[0]) & (ticks < high[1]), 1.0, 0.02) if high is not None else np.full(TICKS, 0.02)
    if false_alarm is not None:
        alpha[false_alarm] = 0.5
    at_home = ticks >= home if home is not None else np.zeros(TICKS, bool)
    return switching_of(alpha, active, at_home, disturbed, PERIOD)


def test_as_it_should():
    switching = run()
    assert (switching.false_switches, switching.alpha_max_before, switching.failure) == (0, 0.02, None)
    assert switching.as_in_paper
    assert switching.decided
    when = [getattr(switching, name) for name in ("onset", "end", "detected", "home", "resumed")]
    assert when == [50, 68, 52, 100, 121]
    assert switching.ticks_disturbed == 71


@pytest.mark.parametrize(
    ("changes", "failure"),
    [
        ({"false_alarm": 10}, "false switch"),
        ({"onset": None, "high": None}, "not disturbed"),
        ({"onset": None, "high": None, "false_alarm": 10}, "false switch"),
        ({"high": None}, "not detected"),
        ({"high": (72, 121)}, None),  # the last tick that counts: end + 4
        ({"high": (73, 121)}, "not detected"),
        ({"home": None}, "not returned"),
        ({"home": 130}, "not returned"),  # the network had the arm before it was home
        ({"high": (52, 160)}, None),  # resumed at 160: 6.0 s after home
        ({"high": (52, 161)}, "not resumed"),
        ({"high": (52, TICKS)}, "not resumed"),
        ({"high": (52, 55)}, "not returned"),  # a short alarm, and the network goes on away from home
        ({"onset": None, "high": None, "disturbed": False}, None),
        ({"onset": None, "high": (30, 40), "disturbed": False}, "false switch"),
    ],
)
def test_failure_kinds(changes, failure):
    found = run(**changes).failure
    assert found == failure
    assert found is None or found in SWITCHING_FAILURES


@pytest.mark.parametrize(
    ("changes", "success"),
    [
        ({}, True),
        ({"false_alarm": 10}, True),  # the paper asks nothing before the disturbance
        ({"high": None}, False),
        ({"high": (73, 121)}, False),  # not noticed in time
        ({"home": None}, False),
        ({"high": (52, 55)}, True),  # let go of at once, but at its initial posture later
        ({"home": 130}, True),
        ({"high": (52, 55), "home": TICKS - 1}, True),  # at the last tick
        ({"high": (52, 161)}, True),  # 6.1 s after it came home, but at home still
        ({"high": (52, TICKS)}, False),
        ({"onset": None, "high": None}, False),
        ({"onset": None, "high": None, "disturbed": False}, True),
        ({"onset": None, "high": (30, 40), "disturbed": False}, False),
    ],
)
def test_switching_in_the_words_of_the_paper(changes, success):
    assert run(**changes).as_in_paper is success


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_what_is_decided_stays_so(data):
    """Runs cut short at every tick: once decided, the failure is that of the whole run.

    And it is decided as early as can be told.
    """
    ticks = data.draw(st.integers(20, 110))
    onset = data.draw(st.integers(0, 15))
    end = onset + data.draw(st.integers(1, 10))
    active = (np.arange(ticks) >= onset) & (np.arange(ticks) < end)
    # Stretches at a few levels, as a run has them.
    pieces = st.lists(
        st.tuples(st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.95]), st.booleans(), st.integers(1, 70)),
        min_size=1,
        max_size=8,
    )
    drawn = data.draw(pieces)
    repeats = [length for _, _, length in drawn[:-1]] + [ticks]
    alpha, at_home = (np.repeat([piece[i] for piece in drawn], repeats)[:ticks] for i in (0, 1))
    disturbed = data.draw(st.booleans())
    if not disturbed:
        active[:] = False

    def cut(n, tail_alpha=(), tail_home=()):
        return switching_of(
            np.append(alpha[:n], tail_alpha), np.append(active[:n], np.zeros(len(tail_alpha), bool)),
            np.append(at_home[:n], np.array(tail_home, bool)), disturbed, PERIOD,
        )  # fmt: skip

    whole = cut(ticks)
    for n in range(1, ticks + 1):
        part = cut(n)
        if part.decided:
            assert part.failure == whole.failure
        elif not active[n:].any() and (active[:n].any() or not disturbed):
            # It can go on so that it ends differently.
            ends = {
                cut(n, [0.95] * 70, [False] * 70).failure,
                cut(n, [0.95] + [0.0] * 70, [True] * 71).failure,
                cut(n, [0.0] * 70, [True] * 70).failure,
                cut(n, [0.0] * 70, [False] * 70).failure,
            }
            assert len(ends) > 1


def test_detected_at_nine_tenths_only():
    ticks = np.arange(TICKS)
    for level, failure in ((0.89, "not detected"), (0.9, None)):
        alpha = np.where((ticks >= 52) & (ticks < 121), level, 0.0)
        active = (ticks >= 50) & (ticks < 68)
        assert switching_of(alpha, active, ticks >= 100, True, PERIOD).failure == failure


def test_resumed_at_one_tenth_only():
    ticks = np.arange(TICKS)
    active = (ticks >= 50) & (ticks < 68)
    for level, failure in ((0.11, "not resumed"), (0.1, None)):
        alpha = np.where(ticks < 52, 0.0, np.where(ticks < 121, 1.0, level))
        assert switching_of(alpha, active, ticks >= 100, True, PERIOD).failure == failure


def test_false_switches_are_counted_once_each():
    alpha = np.zeros(TICKS)
    alpha[10:14] = alpha[20] = 0.7
    nothing = np.zeros(TICKS, bool)
    switching = switching_of(alpha, nothing, nothing, False, PERIOD)
    assert (switching.false_switches, switching.alpha_max_before) == (2, 0.7)


def test_alpha_before_the_onset_is_reported():
    alpha = np.zeros(TICKS)
    alpha[49], alpha[50:] = 0.4, 1.0
    active = np.zeros(TICKS, bool)
    active[50:60] = True
    assert switching_of(alpha, active, active, True, PERIOD).alpha_max_before == 0.4


def test_time_disturbed_without_recovery_is_the_disturbance():
    assert run(home=None).ticks_disturbed == 18
    assert run(onset=None, high=None).ticks_disturbed == 0


PLACE, NEIGHBOUR = np.array([0.2, 0.4, 0.1]), np.array([0.3, 0.3, 0.1])
HOME = np.array([0.5, 0.5, 0.0, 1.4, 0.0, 1.0, 0.0, 0.08])
MONITOR = TaskMonitor(PLACE, NEIGHBOUR, HOME)


def poses(off=0.0, neighbour_off=0.0, tilt_deg=0.0, neighbour_tilt_deg=0.0):
    def quaternion(degrees):
        half = np.deg2rad(degrees) / 2
        return [np.cos(half), np.sin(half), 0.0, 0.0]

    return np.concatenate(
        [
            quaternion(tilt_deg), PLACE + [off, 0, 0],
            quaternion(neighbour_tilt_deg), NEIGHBOUR + [0, neighbour_off, 0],
        ]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "done"),
    [
        ({}, True),
        ({"off": 0.029}, True),
        ({"off": 0.031}, False),
        ({"tilt_deg": 14}, True),
        ({"tilt_deg": 16}, False),
        ({"tilt_deg": 180}, False),
        ({"neighbour_off": 0.019}, True),
        ({"neighbour_off": 0.021}, False),
        ({"neighbour_tilt_deg": 16}, False),
    ],
)
def test_cans(changes, done):
    assert MONITOR.success(poses(**changes), HOME) is done


@pytest.mark.parametrize("joint", range(7))
def test_home_is_three_degrees_a_joint(joint):
    posture = HOME.copy()
    posture[joint] += np.deg2rad(2.9)
    assert MONITOR.success(poses(), posture)
    posture[joint] += np.deg2rad(0.2)
    assert not MONITOR.success(poses(), posture)


def test_closed_fingers_have_not_released():
    assert not MONITOR.success(poses(), np.append(HOME[:-1], 0.03))


def test_tilt_by_hand():
    half = np.deg2rad(30) / 2
    assert tilt(np.array([np.cos(half), 0, np.sin(half), 0, 0, 0, 0])) == pytest.approx(np.deg2rad(30))
    assert tilt(np.array([2 * np.cos(half), 0, 0, 2 * np.sin(half), 0, 0, 0])) == pytest.approx(0.0)  # about its axis


def test_outcome_is_plain_enough_for_json():
    outcome = Outcome(
        seed=1, rnn="lstm", detector="recall", disturbance="A", can_xy=(0.5, 0.0), vacant="left", picked=True,
        placed=MONITOR.placed(poses()), home=bool(MONITOR.home(HOME)), success=MONITOR.success(poses(), HOME),
        switched=True,
        detection_delay_s=0.2, false_switches=0, returned=True, resumed=True, switch_success=True,
        paper_switch_success=True, alpha_max_before=0.0, return_s=2.0, resume_s=1.0, failure=None,
        switch_failure=None, sim_seconds=30.0,
    )  # fmt: skip
    back = json.loads(json.dumps(outcome.to_dict()))
    assert (back["can_xy"], back["placed"], back["failure"]) == ([0.5, 0.0], True, None)
