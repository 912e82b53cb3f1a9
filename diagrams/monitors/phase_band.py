"""A functional band: a threshold that goes with the phase of the subtask, beside the constant one.

One-sided, as FAIL-Detect has it (Xu et al., "Can we detect failures without failure data?", RSS 2025, after
Diquigiovanni et al., "Conformal prediction bands for multivariate functional data", 2022): mean(t) + gamma scale(t),
mean and scale from one half of the calibration runs, gamma from the other by split conformal prediction on the largest
(e(t) - mean(t)) / scale(t) of a run. So it promises what a constant threshold does. Its t there is the time of the run;
here it is known in the tick, and runs that take longer stay aligned:

The phase is the number of ticks since the arm was last at home; in subtask 2 it left home with closed fingers. A run
that is longer than most stays in the last phase.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagrams.world.task import at_home, released

REACHED = 0.5  # of the runs: in the last phase are the ticks from the first that fewer of the runs come to
LEAST_SCALE = 0.1  # of the deviation over all ticks: where all runs are alike, such as before the first prediction


def phases(posture: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """(T, 2) int, subtask (0, 1) and ticks since the arm was last at home, of `posture` (T, M) with `initial` (M,).

    Before the arm was at home for the first time it left with the fingers that it has then. Known in the tick.
    """
    home, ticks = at_home(posture[:, :-1], initial[:-1]), np.arange(len(posture))
    last = np.maximum.accumulate(np.where(home, ticks, 0))
    closed = ~released(posture, initial[-1])
    return np.stack((closed[last].astype(int), ticks - last), axis=1)


@dataclass(frozen=True)
class Band:
    """Of one detector: mean and scale of each subtask's phases, from 0 to the last one."""

    mean: tuple[np.ndarray, np.ndarray]
    scale: tuple[np.ndarray, np.ndarray]

    @classmethod
    def fit(cls, ratios: Sequence[np.ndarray], phase: Sequence[np.ndarray]) -> "Band":
        """From runs: the largest error of each tick by its mean, (T_i,), and their `phases` (T_i, 2)."""
        values, places = np.concatenate(ratios).astype(float), np.concatenate(phase)
        least = LEAST_SCALE * values.std() or 1.0
        mean, scale = [], []
        for subtask in (0, 1):
            longest = sorted(own.max() for p in phase if len(own := p[p[:, 0] == subtask, 1]))
            last = int(longest[int((1.0 - REACHED) * len(longest))]) if longest else 0
            where = np.where(places[:, 0] == subtask, np.minimum(places[:, 1], last), -1)
            # Of a subtask that no run has: what is known of all ticks.
            of_phase = [values[where == k] for k in range(last + 1)] if longest else [values]
            mean.append(np.array([part.mean() for part in of_phase]))
            scale.append(np.array([max(part.std(), least) for part in of_phase]))
        return cls((mean[0], mean[1]), (scale[0], scale[1]))

    def scores(self, ratio: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """(T,) how far above the mean of its phase each tick is, by the scale."""
        found = np.empty(len(ratio))
        for subtask in (0, 1):
            own = phase[:, 0] == subtask
            at = np.minimum(phase[own, 1], len(self.mean[subtask]) - 1)
            found[own] = (ratio[own] - self.mean[subtask][at]) / self.scale[subtask][at]
        return found
