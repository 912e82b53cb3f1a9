"""The switching of a run, and the one definition of its success.

Disturbed: alpha < 0.5 at every tick before the onset; alpha >= 0.9 before the end of the disturbance + 5 ticks; from
then on alpha >= 0.5 until the arm is at its initial posture; alpha <= 0.1 within 6 s after that. Undisturbed: alpha <
0.5 throughout.
Beside it, for the comparison with the paper, whose words ask for less: alpha >= 0.9 as above, and the arm at its
initial posture at some later tick, whoever led it there and whatever alpha was meanwhile, with alpha <= 0.1 within 6 s
after that tick. Undisturbed: as above.
"""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from systems.dwell_time import GUARD

DETECTED, RESUMED = 0.9, 0.1  # values of alpha
DETECTION_TICKS = 5  # after the end of the disturbance
RESUME_SECONDS = 6.0  # after the arm is at its initial posture

# When a run ends before its time is up: with the task done; or once the switching's success, or the detection's, is
# decided.
Until = Literal["task", "switching", "detection"]

DEFEATS = ("not detected", "not returned", "not resumed")
SWITCHING_FAILURES = ("false switch", "not disturbed", *DEFEATS)


@dataclass(frozen=True)
class Switching:
    """The switching of one run, from its ticks; tick indices are None where the event did not come."""

    false_switches: int
    alpha_max_before: float
    failure: str | None
    as_in_paper: bool  # success in the paper's words
    decided: bool  # no later tick can change `failure`
    onset: int | None = None
    end: int | None = None  # first tick after the disturbance
    detected: int | None = None
    home: int | None = None
    resumed: int | None = None

    @classmethod
    def of(cls, alpha: np.ndarray, active: np.ndarray, at_home: np.ndarray, disturbed: bool, period: float) -> Self:
        """`alpha`, `active`, `at_home`: (ticks,) arrays; `disturbed`: whether a disturbance was due."""
        came = disturbed and bool(active.any())
        onset = int(np.argmax(active)) if came else len(alpha)
        high = alpha >= GUARD
        crossings = int(np.count_nonzero(np.diff(high[:onset].astype(int), prepend=0) > 0))
        largest = float(alpha[:onset].max(initial=0.0))
        if not came:
            failure = "false switch" if crossings else ("not disturbed" if disturbed else None)
            return cls(crossings, largest, failure, as_in_paper=failure is None, decided=crossings > 0)
        end = onset + int(np.count_nonzero(active))
        detected = _first(alpha >= DETECTED, onset, end + DETECTION_TICKS)
        home = resumed = let_go = None
        as_in_paper, patience = False, round(RESUME_SECONDS / period) + 1
        if detected is not None:
            start = max(detected, end)
            let_go = _first(~high, start, len(alpha))
            home = _first(at_home, start, len(alpha) if let_go is None else let_go)
            if home is not None:
                resumed = _first(alpha <= RESUMED, home, home + patience)
            homes, low = np.flatnonzero(at_home[start:]) + start, np.append(np.flatnonzero(alpha <= RESUMED), np.inf)
            as_in_paper = bool(np.any(low[np.searchsorted(low, homes)] < homes + patience))
        # What is missing, and whether it can still come.
        if detected is None:
            failure, over = "not detected", len(alpha) >= end + DETECTION_TICKS
        elif home is None:
            failure, over = "not returned", let_go is not None
        else:
            failure, over = ("not resumed" if resumed is None else None), len(alpha) >= home + patience
        if crossings:
            failure = "false switch"
        decided = bool(crossings) or (not active[-1] and (over or resumed is not None))
        return cls(crossings, largest, failure, as_in_paper, decided, onset, end, detected, home, resumed)

    @property
    def ticks_disturbed(self) -> int:
        """From the onset until the network has the arm again; else the disturbance alone."""
        if self.onset is None or self.end is None:
            return 0
        return (self.resumed if self.resumed is not None else self.end) - self.onset


def _first(condition: np.ndarray, start: int, stop: int) -> int | None:
    """First index in [start, stop) at which `condition` holds."""
    hits = np.flatnonzero(condition[start:stop])
    return start + int(hits[0]) if len(hits) else None
