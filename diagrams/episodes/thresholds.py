"""How mean errors, beta and gamma of a detector are found from validation runs: the rules, side by side.

E criteria: N + 1 of the recall (scaled units squared), one a joint of the two others (rad, rad^2). The score of a
stretch of ticks is the largest ratio of an error to its mean on normal runs, over criteria and ticks: dimensionless.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record, stretches
from models.errors import InputError

CONFIDENCE = 0.95  # over the draw of the calibration runs


@dataclass(frozen=True)
class ValidationRun:
    """What came of a run, and how large its errors became."""

    outcome: Outcome
    ticks: int  # before the onset; of the whole run without one
    total: np.ndarray  # (E,) sum over these
    before: np.ndarray | None  # (E,) largest of these; None: there are none
    after: np.ndarray | None  # (E,) largest from the onset to the end of the disturbance; None: no onset

    @classmethod
    def of(cls, outcome: Outcome, record: Record) -> Self:
        """What came of `record`."""
        before, after = (record.errors[ticks] for ticks in stretches(record))
        largest = (part.max(axis=0) if len(part) else None for part in (before, after))
        return cls(outcome, len(before), before.sum(axis=0), *largest)

    def row(self) -> dict[str, Any]:
        """Plain types, for JSON, to the bit."""
        arrays = {name: getattr(self, name) for name in ("total", "before", "after")}
        plain = {name: None if array is None else array.tolist() for name, array in arrays.items()}
        return {"outcome": self.outcome.to_dict(), "ticks": self.ticks} | plain

    @classmethod
    def of_row(cls, row: dict[str, Any]) -> Self:
        """From what `row` gave."""
        before, after = (None if row[name] is None else np.array(row[name]) for name in ("before", "after"))
        outcome = Outcome(**row["outcome"] | {"can_xy": tuple(row["outcome"]["can_xy"])})
        return cls(outcome, row["ticks"], np.array(row["total"]), before, after)


Disturbed = Mapping[str, Sequence[ValidationRun]]  # by kind


def mean_errors(runs: Sequence[ValidationRun]) -> np.ndarray:
    """(E,) over the ticks of the undisturbed `runs` that did their task: the others may have left what was learned.

    Raises InputError where none did, or where a criterion has no error at all.
    """
    done = [run for run in runs if run.outcome.success]
    if not done:
        raise InputError("no undisturbed validation task was finished: calibrate a network that does its task")
    mean = np.sum([run.total for run in done], axis=0) / sum(run.ticks for run in done)
    if np.any(mean == 0.0):
        raise InputError(f"criterion {int(np.argmin(mean)) + 1} has no error at all on normal runs: fit on other runs")
    return mean


def scores(largest: Sequence[np.ndarray | None], means: np.ndarray) -> np.ndarray:
    """(R,) of the stretches with these largest errors; without those that have no tick."""
    return np.array([np.max(errors / means) for errors in largest if errors is not None])


def share_above(n: int, rank: Any) -> Any:
    """The share of fresh scores above the `rank`-th smallest of `n`, at most, with CONFIDENCE over the draw of the n.

    For scores that are drawn alike, whatever from: the share is Beta distributed, as order statistics are. Of no rank,
    0, it is all. `rank`: a whole number, or an array of them; so the share.
    """
    from scipy.stats import beta

    return np.where(np.equal(rank, 0), 1.0, 1.0 - beta.ppf(1.0 - CONFIDENCE, np.maximum(rank, 1), n + 1 - rank))[()]


@dataclass(frozen=True)
class Conformal:
    """The gamma of split conformal prediction, and what it promises."""

    gamma: float
    rank: int  # gamma is the rank-th smallest
    n: int  # of so many scores

    @property
    def average(self) -> float:
        """The probability of a false alarm in a fresh run, at most, over the draw of the n runs and of that one."""
        return (self.n + 1 - self.rank) / (self.n + 1)

    @property
    def share(self) -> float:
        """The same, at most, with CONFIDENCE over the draw of the n runs."""
        return float(share_above(self.n, self.rank))

    def words(self) -> str:
        """What is promised."""
        return (
            f"gamma {self.gamma:.2f}, number {self.rank} of the scores of {self.n} undisturbed runs in rising order: a "
            f"fresh run has a false alarm with a probability of at most {self.average:.2%} on average over such draws, "
            f"and with {CONFIDENCE:.0%} confidence of at most {self.share:.2%}"
        )


def conformal(undisturbed: np.ndarray, delta: float) -> Conformal:
    """The smallest gamma of the scores `undisturbed` (n,) with at most `delta` false alarms, with CONFIDENCE.

    Where n is too small for that (59, 149, 299 allow 5, 2, 1 %), the largest score: `Conformal.words` says what it
    promises. The runs must be drawn as the fresh ones are, nothing learned or chosen from them, none left out. Raises
    InputError without a score.
    """
    if not (n := len(undisturbed)):
        raise InputError("gamma needs one undisturbed validation run at least: raise --runs")
    kept = np.flatnonzero(share_above(n, np.arange(1, n + 1)) <= delta)
    rank = int(kept[0]) + 1 if len(kept) else n
    return Conformal(float(np.sort(undisturbed)[rank - 1]), rank, n)


@dataclass(frozen=True)
class Misses:
    """What gamma means for disturbed runs of one kind."""

    n: int
    missed: int  # of these at `gamma`
    highest: float  # the largest gamma whose misses `conformal` bounds as it does the false alarms
    share: float  # of misses under such a gamma, at most, with CONFIDENCE

    def words(self, kind: str, gamma: float) -> str:
        """How many are missed, and whether a gamma lies between."""
        share = share_above(self.n, self.n - self.missed)
        fits = "this gamma keeps both bounds" if gamma <= self.highest else "no gamma keeps both bounds"
        return (
            f"disturbance {kind}: {self.missed} of {self.n} not noticed, with {CONFIDENCE:.0%} confidence at most "
            f"{share:.2%} of fresh ones; a gamma up to {self.highest:.2f} would miss at most {self.share:.2%}: {fits}"
        )


def misses(disturbed: np.ndarray, gamma: float, margin: float, delta: float) -> Misses:
    """Of the scores `disturbed` (n,), by the rule of `conformal` the other way round.

    `margin`: how far above gamma a score must be for alpha to count as noticed. Raises InputError without a score.
    """
    if not len(disturbed):
        raise InputError("no disturbance came in any validation run: raise --disturbed")
    mirrored = conformal(-disturbed, delta)
    missed = int(np.sum(disturbed < gamma + margin))
    return Misses(len(disturbed), missed, -mirrored.gamma - margin, mirrored.share)


@dataclass(frozen=True)
class Thresholds:
    """What the runs say about a detector that is tuned in closed loop, and the scores that it comes from."""

    mean_errors: np.ndarray  # (E,)
    gamma: float
    normal: np.ndarray  # (R,) scores of normal stretches
    disturbed: dict[str, np.ndarray]  # (D,) of disturbed stretches, by kind

    def words(self) -> str:
        """The scores and gamma in one line."""
        peaks = {"undisturbed": self.normal} | {f"disturbance {kind}": d for kind, d in self.disturbed.items()}
        return f"largest error by its mean: {spans(peaks)}; gamma {self.gamma:.1f}"


def spans(peaks: Mapping[str, np.ndarray]) -> str:
    """Of scores, in words."""
    parts = [f"{k} {p.min():.1f} to {p.max():.1f} (median {np.median(p):.1f})" for k, p in peaks.items() if len(p)]
    return ", ".join(parts)


def by_count(undisturbed: Sequence[ValidationRun], disturbed: Disturbed) -> Thresholds:
    """Where the tuning in closed loop begins: gamma by `most_judged_right`, before an onset too.

    Raises InputError as `mean_errors` does, and where no disturbance came.
    """
    mean = mean_errors(undisturbed)
    normal = scores([run.before for runs in (undisturbed, *disturbed.values()) for run in runs], mean)
    reached = {kind: scores([run.after for run in runs], mean) for kind, runs in disturbed.items()}
    if not any(map(len, reached.values())):
        raise InputError("no disturbance came in any validation run: raise --disturbed")
    return Thresholds(mean, most_judged_right(normal, np.concatenate([*reached.values()])), normal, reached)


def most_judged_right(normal: np.ndarray, disturbed: np.ndarray) -> float:
    """The gamma with most of `normal` (R,) below, of `disturbed` (D,) above: the geometric middle of the widest gap."""
    edges = np.unique(np.concatenate([normal, disturbed]))
    # Beyond all peaks too: a gamma that calls everything normal, or nothing.
    edges = np.concatenate([[0.5 * edges[0]], edges, [2.0 * edges[-1]]])
    middles = np.maximum(np.sqrt(edges[:-1] * edges[1:]), np.nextafter(edges[:-1], np.inf))  # above the lower one
    right = np.array([np.sum(normal < gamma) + np.sum(disturbed >= gamma) for gamma in middles])
    width = np.where(right == right.max(), edges[1:] / edges[:-1], 0.0)
    return float(middles[np.argmax(width)])


def best_in_loop(
    gamma: float,
    factors: Sequence[float],
    betas: Sequence[float],
    switched_right: Callable[[float, float], Sequence[bool | None]],
) -> tuple[float, float, list[dict[str, float]]]:
    """The beta and gamma with the largest share of switching successes in closed loop, and all trials.

    First `gamma` times each of `factors` with the first of `betas`, then the best gamma with the other betas; the first
    of several best ones is taken. `switched_right`: of each episode with a beta and a gamma; None: void, not counted.
    """

    def trial(beta: float, gamma: float) -> dict[str, float]:
        right = [found for found in switched_right(beta, gamma) if found is not None]
        print(f"  beta {beta:g}, gamma {gamma:.1f}: {sum(right)} of {len(right)} switched right", flush=True)
        return {"beta": beta, "gamma": gamma, "successes": sum(right), "episodes": len(right)}

    def share(trial: dict[str, float]) -> float:
        return trial["successes"] / max(trial["episodes"], 1)

    trials = [trial(betas[0], factor * gamma) for factor in factors]
    found = max(trials, key=share)
    trials += [trial(beta, found["gamma"]) for beta in betas[1:]]
    found = max(trials, key=share)
    return found["beta"], found["gamma"], trials
