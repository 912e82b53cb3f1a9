"""How a detector's references and gamma are found from validation runs with the detector off: the rules, side by side.

E criteria: N + 1 of the recall (scaled units squared), one a joint of the two others (rad, rad^2). A ratio is an error
divided by its reference, dimensionless; the peak of a stretch of ticks is its largest ratio over criteria and ticks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record, stretches
from models.errors import InputError


@dataclass(frozen=True)
class ErrorPeaks:
    """How large the errors of one run became."""

    outcome: Outcome
    ticks: int  # before the onset; of the whole run without one
    total: np.ndarray  # (E,) sum over these
    before: np.ndarray | None  # (E,) largest of these; None: there are none
    after: np.ndarray | None  # (E,) largest from the onset to the end of the disturbance + 5 ticks; None: no onset

    @staticmethod
    def of(outcome: Outcome, record: Record, errors: np.ndarray) -> ErrorPeaks:
        """`errors`: (n, E) of the run."""
        before, after = (errors[ticks] for ticks in stretches(record))
        largest = (part.max(axis=0) if len(part) else None for part in (before, after))
        return ErrorPeaks(outcome, len(before), before.sum(axis=0), *largest)


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
        stretches = {"undisturbed": self.normal} | {f"disturbance {kind}": d for kind, d in self.disturbed.items()}
        peaks = (
            f"{name} {peaks.min():.1f} to {peaks.max():.1f} (median {np.median(peaks):.1f})"
            for name, peaks in stretches.items()
            if len(peaks)
        )
        return f"largest error by its reference: {', '.join(peaks)}; gamma {self.gamma:.1f}"


def by_spread(undisturbed: Sequence[ErrorPeaks], disturbed: Mapping[str, Sequence[ErrorPeaks]]) -> Thresholds:
    """The recall's: references that few normal runs reach; gamma by `middle_of_spreads` for the kind that is harder to notice.

    Raises InputError where too few runs finished, or where the disturbed ones show no larger errors.
    """
    done = _done(undisturbed)
    references = rarely_reached(np.array([run.before for run in done]))
    normal = _peaks([run.before for run in done], references)
    reached = {kind: _peaks([run.after for run in runs], references) for kind, runs in disturbed.items()}
    gamma, _ = min((middle_of_spreads(normal, peaks) for peaks in reached.values()), key=lambda found: found[1])
    return Thresholds(_mean(done), references, gamma, normal, reached)


def by_count(undisturbed: Sequence[ErrorPeaks], disturbed: Mapping[str, Sequence[ErrorPeaks]]) -> Thresholds:
    """The other detectors': references are the mean errors; gamma by `most_judged_right`.

    Normal stretches are those before an onset too. Raises InputError where no undisturbed run finished, where a criterion
    has no error at all, and where no disturbance came.
    """
    done = _done(undisturbed)  # one that failed may have left the learned trajectory by itself
    mean = _mean(done)
    if np.any(mean == 0.0):
        raise InputError(f"criterion {int(np.argmin(mean)) + 1} has no error at all on normal runs: fit on other runs")
    normal = [run.before for runs in (done, *disturbed.values()) for run in runs]
    reached = {kind: _peaks([run.after for run in runs], mean) for kind, runs in disturbed.items()}
    if not any(map(len, reached.values())):
        raise InputError("no disturbance came in any validation run: raise --disturbed")
    peaks = _peaks(normal, mean)
    return Thresholds(mean, mean, most_judged_right(peaks, np.concatenate([*reached.values()])), peaks, reached)


def rarely_reached(peaks: np.ndarray) -> np.ndarray:
    """(E,) what a run's largest error exceeds in 2 of 100 runs, by the logarithms of `peaks` (R, E): mean + 2 standard deviations.

    The paper refers l_n to its mean on normal runs. But far back the recall is poor for a few ticks of some runs: one gamma
    for all n must lie above those, and misses stops that a small n tells. Raises InputError for fewer than two runs.
    """
    if len(peaks) < 2:
        raise InputError("reference errors need two finished undisturbed episodes at least: raise their number")
    logs = np.log(peaks)
    return np.exp(logs.mean(axis=0) + 2.0 * logs.std(axis=0, ddof=1))


def middle_of_spreads(normal: np.ndarray, disturbed: np.ndarray) -> tuple[float, float]:
    """gamma between peaks (R,), (D,): as many standard deviations of their logarithms from either mean; and how many.

    Not the middle of the gap: the extremes of some tens of runs say little about the next hundred. Raises InputError with
    fewer than two of either, or where the disturbed ones are no larger.
    """
    if min(len(normal), len(disturbed)) < 2:
        raise InputError(
            "gamma needs two finished undisturbed and two disturbed episodes at least: raise their numbers"
        )
    low, high = np.log(normal), np.log(disturbed)
    spread = low.std(ddof=1) + high.std(ddof=1)
    if high.mean() <= low.mean():
        raise InputError(
            "disturbed runs have no larger errors than normal ones: the recall tells nothing, train its heads longer"
        )
    deviations = (high.mean() - low.mean()) / spread if spread > 0.0 else np.inf
    share = low.std(ddof=1) / spread if spread > 0.0 else 0.5
    return float(np.exp(low.mean() + share * (high.mean() - low.mean()))), float(deviations)


def most_judged_right(normal: np.ndarray, disturbed: np.ndarray) -> float:
    """The gamma with most of `normal` (R,) below and of `disturbed` (D,) above it: the geometric middle of the widest such gap."""
    edges = np.unique(np.concatenate([normal, disturbed]))
    # Beyond all peaks too: a gamma that calls everything normal, or nothing.
    edges = np.concatenate([[0.5 * edges[0]], edges, [2.0 * edges[-1]]])
    middles = np.sqrt(edges[:-1] * edges[1:])
    right = np.array([np.sum(normal < gamma) + np.sum(disturbed >= gamma) for gamma in middles])
    width = np.where(right == right.max(), edges[1:] / edges[:-1], 0.0)
    return float(middles[np.argmax(width)])


def best_in_loop(
    gamma: float, factors: Sequence[float], betas: Sequence[float], run: Callable[[float, float], Sequence[Outcome]]
) -> tuple[float, float, list[dict[str, float]]]:
    """The beta and gamma with most switching successes in closed loop, the first of the best; and how each did.

    First `gamma` times each of `factors` with the first of `betas`, then the best gamma with the other betas. `run`: the
    outcomes with a beta and a gamma.
    """
    trials: list[dict[str, float]] = []

    def best(candidates: list[tuple[float, float]]) -> tuple[float, float]:
        for beta, value in candidates:
            outcomes = run(beta, value)
            successes = sum(outcome.switch_success for outcome in outcomes)
            print(f"  beta {beta:g}, gamma {value:.1f}: {successes} of {len(outcomes)} switched right", flush=True)
            trials.append({"beta": beta, "gamma": value, "successes": successes, "episodes": len(outcomes)})
        found = max(trials, key=lambda trial: trial["successes"])
        return found["beta"], found["gamma"]

    first, *others = betas
    _, gamma = best([(first, factor * gamma) for factor in factors])
    return *best([(beta, gamma) for beta in others]), trials


def _done(runs: Sequence[ErrorPeaks]) -> list[ErrorPeaks]:
    done = [run for run in runs if run.outcome.success]
    if not done:
        raise InputError("no undisturbed validation task was finished: calibrate a network that does its task")
    return done


def _mean(runs: Sequence[ErrorPeaks]) -> np.ndarray:
    return np.sum([run.total for run in runs], axis=0) / sum(run.ticks for run in runs)


def _peaks(largest: Sequence[np.ndarray | None], references: np.ndarray) -> np.ndarray:
    return np.array([np.max(errors / references) for errors in largest if errors is not None])
