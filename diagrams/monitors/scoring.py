"""What a detector says of a tape: its largest errors, and its alarms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Peaks = list[tuple[int, float]]  # each tick whose error is larger than all before, and that error


@dataclass(frozen=True)
class Score:
    """Of one detector on one run; ticks of the run, errors by their mean on normal runs (dimensionless)."""

    alarm: int | None  # the first from the onset on, of all without one
    false_alarms: int  # how often the alarm rose before the onset, or without one
    peaks: Peaks

    @classmethod
    def of(cls, ratio: np.ndarray, gamma: float, onset: int | None) -> "Score":
        """Of the largest error of each tick by its mean, (T,); an alarm is where that is `gamma` or more."""
        high = ratio >= gamma
        since = high[0 if onset is None else onset :]
        alarm = int(np.argmax(since)) + (onset or 0) if since.any() else None
        before = high[: len(high) if onset is None else onset]
        return cls(alarm, int((np.diff(before.astype(int), prepend=0) == 1).sum()), peaks(ratio))


def peaks(values: np.ndarray) -> Peaks:
    """Of (T,): where, and to what, the largest so far rises."""
    largest = np.maximum.accumulate(values)
    rises = np.flatnonzero(np.diff(largest, prepend=-np.inf) > 0.0)
    return [(int(tick), float(largest[tick])) for tick in rises]


def largest_before(found: Sequence[Sequence[float]], ticks: int) -> float:
    """The largest value of the first `ticks` ticks, one or more, of those whose `peaks` these are."""
    return max(value for tick, value in found if tick < ticks)
