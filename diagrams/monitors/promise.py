"""What split conformal prediction promises of false alarms, and whether fresh runs keep it. Arrays alone.

Gamma is the k-th smallest of n scores, k = n + 1 - l, l = floor((n + 1) delta). Of runs that are drawn alike, whatever
their scores are, a fresh one exceeds it with a probability of at most l / (n + 1) <= delta, on average over the draw of
the n; given these it is Beta(l, n + 1 - l) distributed, so the number of false alarms in N fresh runs beta-binomial
(Vovk, "Conditional validity of inductive conformal predictors", 2012; Angelopoulos and Bates, "A gentle introduction to
conformal prediction", 2021, Sec. 3.2). With equal scores there are fewer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import InputError

LEVEL = 0.05  # of the tests; and the intervals have 1 - LEVEL


@dataclass(frozen=True)
class Threshold:
    """A gamma, and of what it comes."""

    gamma: float
    allowed: int  # l
    n: int

    @classmethod
    def of(cls, scores: np.ndarray, delta: float) -> "Threshold":
        """From the scores (n,) of the calibration runs; raises InputError where n is too small for `delta`."""
        n = len(scores)
        if not (count := allowed(n, delta)):
            raise InputError(f"{n} calibration runs are too few for a delta of {delta}: take {fewest(delta)} or more")
        return cls(float(np.sort(scores)[n - count]), count, n)

    @property
    def promised(self) -> float:
        """The probability of a false alarm of a fresh run, at most, on average over the draw of the n."""
        return self.allowed / (self.n + 1)

    def judged(self, fresh: np.ndarray) -> dict[str, Any]:
        """What the scores (N,) of fresh runs say of the promise; plain types.

        `interval`: of their probability of a false alarm (Clopper and Pearson); `expected`: in which the count lies
        with a probability of 1 - LEVEL, if the promise holds; `p`: of so many or more, if it holds.
        """
        from scipy.stats import betabinom, binomtest

        count, n = int((fresh > self.gamma).sum()), len(fresh)
        law = betabinom(n, self.allowed, self.n + 1 - self.allowed)
        bounds = binomtest(count, n).proportion_ci(1.0 - LEVEL, method="exact")
        expected = [int(law.ppf(0.5 * LEVEL)), int(law.ppf(1.0 - 0.5 * LEVEL))]
        return {
            "gamma": self.gamma, "allowed": self.allowed, "of": self.n, "promised": self.promised, "n": n,
            "false_alarms": count,
            "at_gamma": int((fresh == self.gamma).sum()), "interval": [float(bounds.low), float(bounds.high)],
            "expected": expected, "as_expected": expected[0] <= count <= expected[1], "p": float(law.sf(count - 1)),
        }  # fmt: skip


def allowed(n: int, delta: float) -> int:
    """l: how many of the n scores lie at gamma or above."""
    return int(np.floor((n + 1) * delta * (1.0 + 1e-12)))  # 0.29 times 100 is 28.999...


def fewest(delta: float) -> int:
    """The least n with a gamma for `delta`."""
    return int(np.ceil(1.0 / delta * (1.0 - 1e-12))) - 1


def holm(p: Sequence[float]) -> list[float]:
    """The p of each test, corrected for their number, in the same order.

    Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(p, kind="stable")
    raised = np.maximum.accumulate(np.asarray(p)[order] * np.arange(len(order), 0, -1))
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(raised, 1.0)
    return corrected.tolist()


def resampled(scores: np.ndarray, n: int, delta: float, splits: Sequence[np.ndarray]) -> dict[str, Any]:
    """How many of the rest gamma covers, when the `scores` (P,) are split into n for the calibration and the rest.

    `splits`: an order of all P each; the first n of it are for the calibration. Plain types: `covered` of each split,
    of `n` others; `mean` and `expected_mean`, shares; `central`: in which their number lies with a probability of
    1 - LEVEL, and `within`, the share of the splits where it does; `distance`: of Kolmogorov and Smirnov, the largest
    between the shares of splits and the probabilities of at most so many. If no two scores are equal, the law of a
    random split is exact, whatever the scores are: what is seen then is the rule, not the detector.
    """
    from scipy.stats import betabinom

    rest, count = len(scores) - n, allowed(n, delta)
    covered = np.array([(scores[o[n:]] <= Threshold.of(scores[o[:n]], delta).gamma).sum() for o in splits])
    law = betabinom(rest, n + 1 - count, count)
    low, high = int(law.ppf(0.5 * LEVEL)), int(law.ppf(1.0 - 0.5 * LEVEL))
    seen = np.searchsorted(np.sort(covered), np.arange(rest + 1), side="right") / len(covered)
    return {
        "n": rest, "covered": covered.tolist(), "mean": float(covered.mean() / rest),
        "expected_mean": 1.0 - count / (n + 1), "central": [low, high],
        "within": float(((covered >= low) & (covered <= high)).mean()),
        "distance": float(np.abs(seen - law.cdf(np.arange(rest + 1))).max()),
    }  # fmt: skip


def missed(alarms: Sequence[float | None]) -> dict[str, Any]:
    """Of disturbed runs, by the seconds from the onset to the alarm, None where there was none; plain types.

    `bound`: the probability of a miss is at most that, with a confidence of 1 - LEVEL (Clopper and Pearson, one-sided).
    """
    from scipy.stats import binomtest

    n, seen = len(alarms), [seconds for seconds in alarms if seconds is not None]
    if not n:
        return {"n": 0, "missed": 0, "bound": 1.0, "detection_s": None}
    bound = binomtest(n - len(seen), n, alternative="less").proportion_ci(1.0 - LEVEL, method="exact").high
    median = float(np.median(seen)) if seen else None
    return {"n": n, "missed": n - len(seen), "bound": float(bound), "detection_s": median}
