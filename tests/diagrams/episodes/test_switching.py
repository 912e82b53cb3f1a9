"""The switching told tick by tick is that of the whole run, by the definition written for arrays; and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagrams.episodes.switching import (
    DETECTED,
    GUARD,
    RESUME_SECONDS,
    RESUMED,
    SWITCHING_FAILURES,
    Switching,
)

PERIOD = 0.1
TICKS = 260


def first(condition, start, stop):
    """First index in [start, stop) at which `condition` holds."""
    hits = np.flatnonzero(condition[start:stop])
    return start + int(hits[0]) if len(hits) else None


def rises(high):
    return int(np.count_nonzero(np.diff(high.astype(int), prepend=0) > 0))


def of_arrays(alpha, active, at_home, disturbed):
    """The module's definition in whole arrays."""
    n, patience, high = len(alpha), round(RESUME_SECONDS / PERIOD) + 1, alpha >= GUARD
    onset = first(active, 0, n) if disturbed else None
    before = n if onset is None else onset
    found = dict.fromkeys(("end", "detected", "home", "resumed"))
    found |= dict(
        onset=onset, false_switches=rises(high[:before]), alpha_max_before=alpha[:before].max(initial=0.0),
        crossings=int(np.count_nonzero(np.diff(high.astype(int), prepend=0))), later_switches=0, ticks_disturbed=0,
    )  # fmt: skip
    false = found["false_switches"] > 0
    if onset is None:
        failure = "false switch" if false else None
        return found | dict(
            failure=failure, void=disturbed, success=None if disturbed and not false else not false,
            as_paper=None if disturbed else not false,
        )  # fmt: skip
    end = first(~active, onset, n)
    detected = first(alpha >= DETECTED, onset, n if end is None else end)
    home = resumed = None
    as_paper = False
    if detected is not None and end is not None:
        # Until the arm is home alpha stays up, from the tick of the detection on, under the disturbance too.
        let_go = first(~high, detected, n)
        home = first(at_home, end, n if let_go is None else let_go)
        resumed = None if home is None else first(alpha <= RESUMED, home, home + patience)
        found["later_switches"] = 0 if resumed is None else rises(high[resumed:])
        homes, low = np.flatnonzero(at_home[end:]) + end, np.append(np.flatnonzero(alpha <= RESUMED), np.inf)
        as_paper = bool(np.any(low[np.searchsorted(low, homes)] < homes + patience))
    missing = [
        ("false switch", false), ("not detected", detected is None), ("not returned", home is None),
        ("not resumed", resumed is None), ("switched again", found["later_switches"] > 0),
    ]  # fmt: skip
    failure = next((kind for kind, true in missing if true), None)
    return found | dict(
        failure=failure, success=failure is None, as_paper=as_paper, void=False, end=end, detected=detected, home=home,
        resumed=resumed, ticks_disturbed=next(k for k in (resumed, end, n) if k is not None) - onset,
    )  # fmt: skip


LEVELS = st.sampled_from([0.0, RESUMED, 0.3, np.nextafter(GUARD, 0.0), GUARD, DETECTED, 1.0])
PIECES = st.lists(st.tuples(LEVELS, st.booleans(), st.integers(1, 70)), min_size=1, max_size=10)


@settings(max_examples=200, deadline=None)
@given(PIECES, st.integers(0, 60), st.integers(0, 30), st.booleans())
def test_told_tick_by_tick_it_is_that_of_the_arrays(pieces, onset, length, disturbed):
    """After each tick: runs of stretches at a few levels of alpha, at home or not, with one disturbance or none."""
    repeats = [length for *_, length in pieces]
    alpha, at_home = (np.repeat([piece[i] for piece in pieces], repeats) for i in (0, 1))
    ticks = np.arange(len(alpha))
    active = (ticks >= onset) & (ticks < onset + length)
    switching = Switching(disturbed, PERIOD)
    for n in range(1, len(alpha) + 1):
        switching.see(float(alpha[n - 1]), bool(active[n - 1]), bool(at_home[n - 1]))
        expected = of_arrays(alpha[:n], active[:n], at_home[:n], disturbed)
        assert {name: getattr(switching, name) for name in expected} == expected
        assert switching.over("detection") == (expected["end"] is not None)
        assert not switching.over("task")


def switching_of(alpha, active, at_home, disturbed, period=PERIOD):
    """Of a whole run: `alpha`, `active`, `at_home` (ticks,) arrays."""
    switching = Switching(disturbed, period)
    for tick in zip(alpha.tolist(), active.tolist(), at_home.tolist(), strict=True):
        switching.see(*tick)
    return switching


def run(onset=50, end=68, high=(52, 121), home=100, disturbed=True, also=()):
    """Disturbed in [onset, end), alpha 1 in `high` and in each stretch of `also`, else 0.02, home from `home` on."""
    ticks = np.arange(TICKS)
    active = (ticks >= onset) & (ticks < end) if onset is not None else np.zeros(TICKS, bool)
    alpha = np.full(TICKS, 0.02)
    for start, stop in [*([high] if high else []), *also]:
        alpha[start:stop] = 1.0
    at_home = ticks >= home if home is not None else np.zeros(TICKS, bool)
    return switching_of(alpha, active, at_home, disturbed)


def test_as_it_should():
    switching = run()
    assert (switching.false_switches, switching.alpha_max_before, switching.failure) == (0, 0.02, None)
    assert (switching.success, switching.as_paper, switching.void, switching.failed) == (True, True, False, None)
    when = [getattr(switching, name) for name in ("onset", "end", "detected", "home", "resumed")]
    assert when == [50, 68, 52, 100, 121]
    assert (switching.ticks_disturbed, switching.crossings, switching.needless_ticks) == (71, 2, 0)
    assert not switching.over("switching")  # it can switch again, as long as the run goes on
    assert switching.over("as_paper")


@pytest.mark.parametrize(
    ("changes", "failure", "failed"),
    [
        ({"also": [(10, 11)]}, "false switch", 10),
        ({"onset": None, "high": None, "also": [(10, 11)]}, "false switch", 10),
        ({"high": None}, "not detected", 68),
        ({"high": (67, 121)}, None, None),  # the last tick of the disturbance
        ({"high": (68, 121)}, "not detected", 68),  # the disturbance is over
        ({"home": None}, "not returned", 121),
        ({"home": 121}, "not returned", 121),  # the network had the arm before it was home
        ({"high": (52, 53), "also": [(54, 121)]}, "not returned", 53),  # let go for a tick under the disturbance
        ({"high": (52, 161)}, None, None),  # resumed at 161: 6.0 s after the tick 100 is 160, see below
        ({"high": (52, 162)}, "not resumed", 160),
        ({"high": (52, TICKS)}, "not resumed", 160),
        ({"high": (52, 55)}, "not returned", 55),  # a short alarm, and the network goes on away from home
        ({"also": [(200, 201)]}, "switched again", 200),
        ({"also": [(TICKS - 1, TICKS)]}, "switched again", TICKS - 1),
        ({"also": [(125, 126)]}, "switched again", 125),
        ({"onset": None, "high": None, "disturbed": False}, None, None),
        ({"onset": None, "high": (30, 40), "disturbed": False}, "false switch", 30),
    ],
)
def test_failure_kinds_and_when_they_are_decided(changes, failure, failed):
    if changes.get("high") == (52, 161):
        changes = changes | {"home": 101}
    found = run(**changes)
    assert (found.failure, found.failed) == (failure, failed)
    assert found.success is (failure is None)
    assert found.over("switching") is (failure is not None)
    assert found.failure is None or found.failure in SWITCHING_FAILURES


def test_a_disturbance_that_never_came_is_neither_success_nor_failure():
    found = run(onset=None, high=None)
    assert (found.void, found.success, found.failure, found.as_paper) == (True, None, None, None)
    assert not found.over("switching")
    assert not found.over("as_paper")
    # A false alarm may have kept it away: that is one nevertheless.
    found = run(onset=None, high=(10, 20))
    assert (found.void, found.success, found.failure, found.as_paper) == (True, False, "false switch", None)


@pytest.mark.parametrize(
    ("changes", "success", "over"),
    [
        ({}, True, True),
        ({"also": [(10, 11)]}, True, True),  # the paper asks nothing before the disturbance
        ({"also": [(200, 201)]}, True, True),  # nor afterwards
        ({"high": None}, False, True),
        ({"high": (68, 121)}, False, True),  # not noticed in time
        ({"home": None}, False, False),
        ({"high": (52, 55)}, True, True),  # let go of at once, but at its initial posture later
        ({"home": 130}, True, True),
        ({"high": (52, 55), "home": TICKS - 1}, True, True),  # at the last tick
        ({"high": (52, 161)}, True, True),  # 6.1 s after it came home, but at home still
        ({"high": (52, TICKS)}, False, False),
        ({"onset": None, "high": None, "disturbed": False}, True, False),
        ({"onset": None, "high": (30, 40), "disturbed": False}, False, True),
    ],
)
def test_switching_in_the_words_of_the_paper(changes, success, over):
    found = run(**changes)
    assert found.as_paper is success
    assert found.over("as_paper") is over


@pytest.mark.parametrize(
    ("changes", "crossings", "needless", "later"),
    [
        ({}, 2, 0, 0),
        ({"also": [(10, 14), (20, 21)]}, 6, 5, 0),  # before
        ({"also": [(200, 230)]}, 4, 30, 1),  # after the recovery
        ({"also": [(200, 203), (210, 211)]}, 6, 4, 2),
        ({"high": (52, 80), "also": [(85, 95)], "home": None}, 4, 10, 0),  # let go away from home, and again
        ({"high": (70, 80), "also": [(85, 95)]}, 4, 10, 0),  # noticed late: the first return is the disturbance's
        ({"high": (52, 110), "also": [(112, 118)]}, 4, 6, 1),
        ({"high": None}, 0, 0, 0),
        ({"onset": None, "high": (30, 40), "disturbed": False}, 2, 10, 0),
        ({"high": (52, TICKS)}, 1, 0, 0),
    ],
)
def test_crossings_and_time_lost_to_needless_returns(changes, crossings, needless, later):
    found = run(**changes)
    assert (found.crossings, found.needless_ticks, found.later_switches) == (crossings, needless, later)


def test_flicker_at_home_before_the_network_has_the_arm_again_is_no_failure():
    alpha = np.zeros(TICKS)
    alpha[52:121] = 1.0
    alpha[110:112] = 0.3  # at home: down, not below 0.1, and up again
    ticks = np.arange(TICKS)
    found = switching_of(alpha, (ticks >= 50) & (ticks < 68), ticks >= 100, True)
    assert (found.failure, found.home, found.resumed) == (None, 100, 121)
    assert (found.crossings, found.needless_ticks) == (4, 0)


@settings(max_examples=200, deadline=None)
@given(PIECES, st.integers(0, 15), st.integers(1, 10), st.booleans(), st.sampled_from(["switching", "as_paper"]))
def test_what_is_over_stays_so(pieces, onset, length, disturbed, until):
    """Runs cut short where they say so: what they are run for is that of the whole run."""
    repeats = [length for *_, length in pieces]
    alpha, at_home = (np.repeat([piece[i] for piece in pieces], repeats) for i in (0, 1))
    ticks = np.arange(len(alpha))
    active = (ticks >= onset) & (ticks < onset + length) & disturbed
    whole, cut = switching_of(alpha, active, at_home, disturbed), Switching(disturbed, PERIOD)
    for tick in zip(alpha.tolist(), active.tolist(), at_home.tolist(), strict=True):
        if cut.over(until):
            break
        cut.see(*tick)
    if until == "as_paper":
        assert cut.as_paper == whole.as_paper
    else:
        assert (cut.success, cut.failure, cut.failed) == (whole.success, whole.failure, whole.failed)


def test_detected_at_nine_tenths_only():
    ticks = np.arange(TICKS)
    for level, failure in ((0.89, "not detected"), (0.9, None)):
        alpha = np.where((ticks >= 52) & (ticks < 121), level, 0.0)
        active = (ticks >= 50) & (ticks < 68)
        assert switching_of(alpha, active, ticks >= 100, True).failure == failure


def test_resumed_at_one_tenth_only():
    ticks = np.arange(TICKS)
    active = (ticks >= 50) & (ticks < 68)
    for level, failure in ((0.11, "not resumed"), (0.1, None)):
        alpha = np.where(ticks < 52, 0.0, np.where(ticks < 121, 1.0, level))
        assert switching_of(alpha, active, ticks >= 100, True).failure == failure


def test_alpha_before_the_onset_is_reported():
    alpha = np.zeros(TICKS)
    alpha[49], alpha[50:] = 0.4, 1.0
    active = np.zeros(TICKS, bool)
    active[50:60] = True
    assert switching_of(alpha, active, active, True).alpha_max_before == 0.4


def test_time_disturbed_without_recovery_is_the_disturbance():
    assert run(home=None).ticks_disturbed == 18
    assert run(onset=None, high=None).ticks_disturbed == 0


def test_the_time_of_a_disturbance_under_way_counts_too():
    """It would end the run at the limit otherwise: its whole length comes on top of it."""
    switching = Switching(disturbed=True, period=PERIOD)
    for k in range(30):
        switching.see(0.0, active=k >= 10, at_home=False)
    assert switching.ticks_disturbed == 20


def test_each_of_several_disturbances_has_its_time():
    """Disturbed, led home and taken up again within it; then disturbed alone; then a way home without an end."""
    switching = Switching(True, PERIOD, several=True)
    for alpha, active, ticks in ((0.0, 0, 9), (1.0, 1, 5), (1.0, 0, 7), (0.0, 0, 9), (0.0, 1, 4), (0.0, 0, 9),
                                 (1.0, 1, 3), (1.0, 0, 50)):  # fmt: skip
        for _ in range(ticks):
            switching.see(alpha, bool(active), False)
    assert switching.ticks_disturbed == 5 + 7 + 4 + 3
    switching.see(0.0, False, True)
    assert switching.ticks_disturbed == 5 + 7 + 4 + 3 + 50
