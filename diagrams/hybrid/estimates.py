"""Intervals of small probabilities: from independent estimates of it, and from counts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.errors import InputError

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A probability and its interval at CONFIDENCE."""

    value: float
    low: float
    high: float

    def overlaps(self, other: "Estimate") -> bool:
        """Whether the intervals have a point in common."""
        return self.low <= other.high and other.low <= self.high

    def plain(self) -> dict:
        """Plain types."""
        return {"estimate": self.value, "interval": [self.low, self.high]}


def of_repetitions(estimates: Sequence[float], smallest: Sequence[float], drawn: int) -> Estimate:
    """The mean of independent `estimates` of one probability, and the interval of a log-normal mean.

    With mean m and variance v of their R logarithms: exp(m + v / 2 -+ t sqrt(v / R + v^2 / (2 (R - 1)))), t of
    Student's distribution with R - 1 degrees of freedom (Cox's method as Olsson, "Confidence intervals for the mean of
    a log-normal distribution", Journal of Statistics Education 13, 2005, has it). That splitting's estimates are near
    log-normal: Cerou et al. 2012, see splitting.py.

    `smallest`: of each, what one point alone would have given. Where an estimate is 0 it stands for the estimate in the
    upper end, and the lower end is 0. Where all are 0 nothing is known of how they scatter: all that is left is that of
    the `drawn` independent points with which they began none was one, see `of_count`. Raises InputError for fewer than
    2 estimates.
    """
    from scipy.stats import t

    count = len(estimates)
    if count < 2:
        raise InputError(f"{count} repetition has no spread: choose --repetitions 2 or more")
    values = np.asarray(estimates, float)
    if not values.any():
        return of_count(0, drawn)
    logs = np.log(np.where(values > 0.0, values, smallest))
    mean, variance = float(logs.mean()), float(logs.var(ddof=1))
    error = np.sqrt(variance / count + variance**2 / (2 * (count - 1)))
    half = float(t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1)) * error
    value, middle = float(values.mean()), mean + 0.5 * variance
    low = float(np.exp(middle - half)) if (values > 0.0).all() else 0.0
    return Estimate(value, min(low, value), min(max(float(np.exp(middle + half)), value), 1.0))


def of_count(count: int, n: int) -> Estimate:
    """`count` of `n` independent trials, and the exact interval of Clopper and Pearson (Biometrika 26, 1934)."""
    from scipy.stats import binomtest

    bounds = binomtest(count, n).proportion_ci(CONFIDENCE, method="exact")
    return Estimate(count / n, float(bounds.low), float(bounds.high))
