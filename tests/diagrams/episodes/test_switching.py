"""The switching told tick by tick is that of the whole run, by the definition written for arrays."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from diagrams.episodes.switching import DETECTED, DETECTION_TICKS, GUARD, RESUME_SECONDS, RESUMED, Switching

PERIOD = 0.1


def first(condition, start, stop):
    """First index in [start, stop) at which `condition` holds."""
    hits = np.flatnonzero(condition[start:stop])
    return start + int(hits[0]) if len(hits) else None


def of_arrays(alpha, active, at_home, disturbed):
    """The module's definition in whole arrays."""
    came = disturbed and bool(active.any())
    onset = int(np.argmax(active)) if came else len(alpha)
    high = alpha >= GUARD
    found = dict.fromkeys(("onset", "end", "detected", "home", "resumed"))
    found["false_switches"] = crossings = int(np.count_nonzero(np.diff(high[:onset].astype(int), prepend=0) > 0))
    found["alpha_max_before"] = float(alpha[:onset].max(initial=0.0))
    if not came:
        failure = "false switch" if crossings else ("not disturbed" if disturbed else None)
        return found | dict(failure=failure, as_in_paper=failure is None, decided=crossings > 0, ticks_disturbed=0)
    end = onset + int(np.count_nonzero(active))
    detected = first(alpha >= DETECTED, onset, end + DETECTION_TICKS)
    home = resumed = let_go = None
    as_in_paper, patience = False, round(RESUME_SECONDS / PERIOD) + 1
    if detected is not None:
        start = max(detected, end)
        let_go = first(~high, start, len(alpha))
        home = first(at_home, start, len(alpha) if let_go is None else let_go)
        if home is not None:
            resumed = first(alpha <= RESUMED, home, home + patience)
        homes, low = np.flatnonzero(at_home[start:]) + start, np.append(np.flatnonzero(alpha <= RESUMED), np.inf)
        as_in_paper = bool(np.any(low[np.searchsorted(low, homes)] < homes + patience))
    if detected is None:
        failure, over = "not detected", len(alpha) >= end + DETECTION_TICKS
    elif home is None:
        failure, over = "not returned", let_go is not None
    else:
        failure, over = ("not resumed" if resumed is None else None), len(alpha) >= home + patience
    return found | dict(
        failure="false switch" if crossings else failure,
        as_in_paper=as_in_paper,
        decided=bool(crossings) or (not active[-1] and (over or resumed is not None)),
        ticks_disturbed=0 if active[-1] else (end if resumed is None else resumed) - onset,
        onset=onset, end=None if active[-1] else end, detected=detected, home=home, resumed=resumed,
    )  # fmt: skip


LEVELS = st.sampled_from([0.0, RESUMED, 0.3, np.nextafter(GUARD, 0.0), GUARD, DETECTED, 1.0])
PIECES = st.lists(st.tuples(LEVELS, st.booleans(), st.integers(1, 70)), min_size=1, max_size=10)


@settings(max_examples=150, deadline=None)
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
        over = disturbed and active[:n][:-DETECTION_TICKS].any() and not active[:n][-DETECTION_TICKS:].any()
        assert switching.detection_over == over
