"""How references, beta and gamma of a detector are found from validation runs: the rules, side by side.

E criteria: N + 1 of the recall (scaled units squared), one a joint of the two others (rad, rad^2). A ratio is an error
divided by its reference, dimensionless; the peak of a stretch of ticks is its largest ratio over criteria and ticks.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Self

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record, stretches
from models.errors import InputError


@dataclass(frozen=True)
class ValidationRun:
    """What came of a run, and how large its errors became."""

    outcome: Outcome
    ticks: int  # before the onset; of the whole run without one
    total: np.ndarray  # (E,) sum over these
    before: np.ndarray | None  # (E,) largest of these; None: there are none
    after: np.ndarray | None  # (E,) largest from the onset to the end of the disturbance + 5 ticks; None: no onset

    @classmethod
    def of(cls, outcome: Outcome, record: Record) -> Self:
        """What came of `record`."""
        before, after = (record.errors[ticks] for ticks in stretches(record))
        largest = (part.max(axis=0) if len(part) else None for part in (before, after))
        return cls(outcome, len(before), before.sum(axis=0), *largest)


Disturbed = Mapping[str, Sequence[ValidationRun]]  # by kind


@dataclass(frozen=True)
class Thresholds:
    """What the runs say about a detector, and the peaks that it comes from."""

    mean_errors: np.ndarray  # (E,) of the undisturbed runs that ended in success
    reference_errors: np.ndarray  # (E,)
    gamma: float
    normal: np.ndarray  # (R,) peaks of normal stretches
    disturbed: dict[str, np.ndarray]  # (D,) peaks of disturbed stretches, by kind

    def words(self) -> str:
        """The peaks and gamma in one line."""
        peaks = {"undisturbed": self.normal} | {f"disturbance {kind}": d for kind, d in self.disturbed.items()}
        parts = [f"{k} {p.min():.1f} to {p.max():.1f} (median {np.median(p):.1f})" for k, p in peaks.items() if len(p)]
        return f"largest error by its reference: {', '.join(parts)}; gamma {self.gamma:.1f}"


def by_spread(undisturbed: Sequence[ValidationRun], disturbed: Disturbed) -> Thresholds:
    """The recall's: references that few normal runs reach; gamma by `middle_of_spreads`, of the kind harder to notice.

    Raises InputError where too few runs finished, or where the disturbed ones show no larger errors.
    """
    done = _done(undisturbed)
    references = rarely_reached(np.array([run.before for run in done]))
    normal = _peaks([run.before for run in done], references)
    reached = {kind: _peaks([run.after for run in runs], references) for kind, runs in disturbed.items()}
    gamma, _ = min((middle_of_spreads(normal, peaks) for peaks in reached.values()), key=lambda found: found[1])
    return Thresholds(_mean(done), references, gamma, normal, reached)


def by_count(undisturbed: Sequence[ValidationRun], disturbed: Disturbed) -> Thresholds:
    """The other detectors': references are the mean errors; gamma by `most_judged_right`, before an onset too.

    Raises InputError where no undisturbed run finished, a criterion has no error at all, or no disturbance came.
    """
    done = _done(undisturbed)  # one that failed may have left the learned trajectory by itself
    mean = _mean(done)
    if np.any(mean == 0.0):
        raise InputError(f"criterion {int(np.argmin(mean)) + 1} has no error at all on normal runs: fit on other runs")
    normal = _peaks([run.before for runs in (done, *disturbed.values()) for run in runs], mean)
    reached = {kind: _peaks([run.after for run in runs], mean) for kind, runs in disturbed.items()}
    if not any(map(len, reached.values())):
        raise InputError("no disturbance came in any validation run: raise --disturbed")
    return Thresholds(mean, mean, most_judged_right(normal, np.concatenate([*reached.values()])), normal, reached)


def rarely_reached(peaks: np.ndarray) -> np.ndarray:
    """(E,) what the largest errors `peaks` (R, E) exceed in 2 of 100 runs: of their logarithms, mean + 2 deviations.

    The paper refers l_n to its mean on normal runs. But far back the recall is poor for a few ticks of some runs: one
    gamma for all n must lie above those, and misses stops that a small n tells. Raises InputError for fewer than two.
    """
    if len(peaks) < 2:
        raise InputError("reference errors need two finished undisturbed episodes at least: raise their number")
    logs = np.log(peaks)
    return np.exp(logs.mean(axis=0) + 2.0 * logs.std(axis=0, ddof=1))


def middle_of_spreads(normal: np.ndarray, disturbed: np.ndarray) -> tuple[float, float]:
    """gamma as many deviations of logarithms from the mean of `normal` (R,) as from that of `disturbed` (D,); how many.

    Not the middle of the gap: the extremes of some tens of runs say little about the next hundred. Raises InputError
    for fewer than two of either, or where the disturbed ones are no larger.
    """
    if min(len(normal), len(disturbed)) < 2:
        raise InputError("gamma needs two finished undisturbed and two disturbed episodes: raise their numbers")
    low, high = np.log(normal), np.log(disturbed)
    gap, spread = high.mean() - low.mean(), low.std(ddof=1) + high.std(ddof=1)
    if gap <= 0.0:
        raise InputError("disturbed runs have no larger errors than normal ones: train the recall's heads longer")
    share = low.std(ddof=1) / spread if spread > 0.0 else 0.5
    return float(np.exp(low.mean() + share * gap)), float(gap / spread) if spread > 0.0 else np.inf


def most_judged_right(normal: np.ndarray, disturbed: np.ndarray) -> float:
    """The gamma with most of `normal` (R,) below, of `disturbed` (D,) above: the geometric middle of the widest gap."""
    edges = np.unique(np.concatenate([normal, disturbed]))
    # Beyond all peaks too: a gamma that calls everything normal, or nothing.
    edges = np.concatenate([[0.5 * edges[0]], edges, [2.0 * edges[-1]]])
    middles = np.sqrt(edges[:-1] * edges[1:])
    right = np.array([np.sum(normal < gamma) + np.sum(disturbed >= gamma) for gamma in middles])
    width = np.where(right == right.max(), edges[1:] / edges[:-1], 0.0)
    return float(middles[np.argmax(width)])


def best_in_loop(
    gamma: float,
    factors: Sequence[float],
    betas: Sequence[float],
    switched_right: Callable[[float, float], Sequence[bool]],
) -> tuple[float, float, list[dict[str, float]]]:
    """The beta and gamma with most switching successes in closed loop, the first of the best; and how each did.

    First `gamma` times each of `factors` with the first of `betas`, then the best gamma with the other betas.
    `switched_right`: of each episode with a beta and a gamma.
    """

    def trial(beta: float, gamma: float) -> dict[str, float]:
        right = switched_right(beta, gamma)
        print(f"  beta {beta:g}, gamma {gamma:.1f}: {sum(right)} of {len(right)} switched right", flush=True)
        return {"beta": beta, "gamma": gamma, "successes": sum(right), "episodes": len(right)}

    trials = [trial(betas[0], factor * gamma) for factor in factors]
    found = max(trials, key=itemgetter("successes"))
    trials += [trial(beta, found["gamma"]) for beta in betas[1:]]
    found = max(trials, key=itemgetter("successes"))
    return found["beta"], found["gamma"], trials


def _done(runs: Sequence[ValidationRun]) -> list[ValidationRun]:
    done = [run for run in runs if run.outcome.success]
    if not done:
        raise InputError("no undisturbed validation task was finished: calibrate a network that does its task")
    return done


def _mean(runs: Sequence[ValidationRun]) -> np.ndarray:
    return np.sum([run.total for run in runs], axis=0) / sum(run.ticks for run in runs)


def _peaks(largest: Sequence[np.ndarray | None], references: np.ndarray) -> np.ndarray:
    return np.array([np.max(errors / references) for errors in largest if errors is not None])
