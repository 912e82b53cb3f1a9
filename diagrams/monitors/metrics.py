"""What a detector's alarms were worth: rates, times and areas, each with an interval over scenes. Arrays alone.

An episode is run with the detector off (`never`), with it in closed loop, and with the oracle. It is *needed* that
somebody notices it where the run with `never` fails its task. An alarm is counted from the fault's onset on; before it,
and without a fault, it is a false one.
"""

import collections
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression

from diagrams.sweeps.summary import rate, resampled

HOUR = 3600.0  # s


@dataclass(frozen=True)
class Monitored:
    """Episodes under one detector, a component of (n,) arrays each; times in s.

    Attributes:
        scene, training_seed: which; the intervals draw scenes, and training seeds within them.
        score: largest score, cut as `largest_scores` does.
        onset: when the fault began; NaN: there was none.
        alarm: the first alarm from the onset on, of all without one, with the detector off; NaN: there was none.
        false_alarms: how many came before the onset, or without one.
        normal_time: how long the episode went on before the onset, or without one.
        length: of the run with `never`.
        needed: whether that failed its task.
        success: whether the task was done in closed loop, oracle_success: and with the oracle; None: that does not act.
        lost: seconds of needless returns in closed loop.
    """

    scene: np.ndarray
    training_seed: np.ndarray
    score: np.ndarray
    onset: np.ndarray
    alarm: np.ndarray
    false_alarms: np.ndarray
    normal_time: np.ndarray
    length: np.ndarray
    needed: np.ndarray
    success: np.ndarray | None
    oracle_success: np.ndarray | None
    lost: np.ndarray

    @property
    def disturbed(self) -> np.ndarray:
        """(n,) whether the fault came."""
        return ~np.isnan(self.onset)

    @property
    def noticed(self) -> np.ndarray:
        """(n,) whether there was an alarm that counts."""
        return ~np.isnan(self.alarm)


def largest_scores(scores: Sequence[np.ndarray]) -> np.ndarray:
    """(n,) largest of the scores (T_i,) of each run, all cut at the length of the shortest: a longer run has more
    chances, and a failed one is longer.
    """
    shortest = min(map(len, scores))
    return np.array([np.max(run[:shortest]) for run in scores])


def labels(episodes: Monitored) -> np.ndarray:
    """(n,) str. With an alarm: `needed` (without it the task fails, with it it's done), `late` (it fails nevertheless),
    `needless` (it's done anyway), `harmful` (only with the alarm it fails). Without: `harmful miss` (the task fails),
    `harmless miss` (a fault, but the task is done), `quiet` (neither fault nor failure). Of a detector that acts.
    """
    assert episodes.success is not None
    # A false alarm has acted too, in closed loop.
    alarm = episodes.noticed | (episodes.false_alarms > 0)
    acted = np.where(
        episodes.needed,
        np.where(episodes.success, "needed", "late"),
        np.where(episodes.success, "needless", "harmful"),
    )
    still = np.where(episodes.needed, "harmful miss", np.where(episodes.disturbed, "harmless miss", "quiet"))
    return np.where(alarm, acted, still)


def contingency(episodes: Monitored) -> dict[str, dict[str, int]]:
    """How often each of `labels`, by whether there was a fault and what came of the run with `never`."""
    found = labels(episodes)
    return {
        f"{'disturbed' if disturbed else 'undisturbed'} {'failure' if failed else 'success'}": dict(
            collections.Counter(found[(episodes.disturbed == disturbed) & (episodes.needed == failed)].tolist())
        )
        for disturbed in (False, True)
        for failed in (False, True)
    }


def area_under_roc(score: np.ndarray, positive: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(...,) of scores (n,), with weights (..., n); ties count half. NaN without a positive, or without a negative."""
    true, false = _at_thresholds(score, positive, weights)
    heights = true + np.diff(true, axis=-1, prepend=0.0) * -0.5  # the middle of each step: ties are a slope
    area = (np.diff(false, axis=-1, prepend=0.0) * heights).sum(axis=-1)
    return _share(area, true[..., -1] * false[..., -1])


def area_under_precision(score: np.ndarray, positive: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(...,) average precision, sum of precision times what recall gains there. NaN without a positive."""
    true, false = _at_thresholds(score, positive, weights)
    precision = np.nan_to_num(_share(true, true + false))
    return _share((np.diff(true, axis=-1, prepend=0.0) * precision).sum(axis=-1), true[..., -1])


def _at_thresholds(score: np.ndarray, positive: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of positives and of negatives at or above each of the scores there are, from the largest down."""
    order = np.argsort(-score, kind="stable")
    ordered, is_positive, weights = score[order], positive[order], weights[..., order]
    last = np.append(np.flatnonzero(np.diff(ordered)), len(ordered) - 1)
    true, false = (np.cumsum(weights * part, axis=-1)[..., last] for part in (is_positive, ~is_positive))
    return true, false


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """`part` of `whole`; NaN of nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0.0, part / whole, np.nan)


Statistic = Callable[[np.ndarray], np.ndarray]  # of weights (..., n), (...,)


def of_share(part: np.ndarray, whole: np.ndarray) -> Statistic:
    """sum of `part` by sum of `whole`, (n,) each."""
    return lambda weights: _share((weights * part).sum(axis=-1), (weights * whole).sum(axis=-1))


def of_median(values: np.ndarray) -> Statistic:
    """The lower median of those of `values` (n,) that are not NaN."""
    order = np.argsort(values, kind="stable")
    ordered = np.nan_to_num(values[order])

    def median(weights: np.ndarray) -> np.ndarray:
        sums = np.cumsum(np.where(np.isnan(values), 0.0, weights)[..., order], axis=-1)
        middle = np.argmax(sums >= 0.5 * sums[..., -1:], axis=-1)
        return np.where(sums[..., -1] > 0.0, ordered[middle], np.nan)

    return median


def statistics(episodes: Monitored, of: str = "needed") -> dict[str, Statistic]:
    """All by name; `of` says what is to be noticed: what is `needed`, as in the literature, or what is `disturbed`.

    Those of the closed loop are not there where nothing acts in it.
    """
    positive, noticed = getattr(episodes, of), episodes.noticed
    negative = ~positive
    # What must not be noticed had no alarm of either kind.
    silent = ~noticed & (episodes.false_alarms == 0)
    true_positive, true_negative = of_share(noticed & positive, positive), of_share(silent & negative, negative)
    early = np.where(noticed & positive, 1.0 - np.nan_to_num(episodes.alarm) / episodes.length, 0.0)
    # A false alarm that is under way at the onset would count as noticed at once.
    delay = np.where(episodes.disturbed & (episodes.false_alarms == 0), episodes.alarm - episodes.onset, np.nan)
    return {
        "tpr": true_positive,
        "tnr": true_negative,
        "balanced_accuracy": lambda weights: 0.5 * (true_positive(weights) + true_negative(weights)),
        "auroc": lambda weights: area_under_roc(episodes.score, positive, weights),
        "auprc": lambda weights: area_under_precision(episodes.score, positive, weights),
        # Timestep-wise accuracy, FIPER (Roemer et al., NeurIPS 2025): an alarm at once counts 1, at the end 0.
        "twa": lambda weights: 0.5 * (of_share(early, positive)(weights) + true_negative(weights)),
        "detection_s": of_median(delay),
        "false_alarms_per_hour": of_share(episodes.false_alarms, episodes.normal_time / HOUR),
    } | _of_the_loop(episodes)


def _of_the_loop(episodes: Monitored) -> dict[str, Statistic]:
    """Those that only runs in closed loop say."""
    if episodes.success is None:
        return {}
    done, never = episodes.success.astype(float), (~episodes.needed).astype(float)
    benefit, everyone = done - never, np.ones(len(done))
    found = {
        "tasks": of_share(done, everyone),
        "seconds_lost": of_share(episodes.lost, everyone),
        "net_benefit": of_share(benefit, everyone),
    }
    if episodes.oracle_success is not None:
        found["gap_closed"] = of_share(benefit, episodes.oracle_success.astype(float) - never)
    return found


def measured(
    episodes: Monitored, of: str = "needed", names: Collection[str] | None = None
) -> dict[str, dict[str, Any] | None]:
    """Each of `statistics`, or those in `names`: `value`, and its 95 % `interval` over scenes.

    None where there is nothing to say it of.

    The interval is a percentile bootstrap's, of the draws in which the statistic exists. A rate of 0 or 1 has the exact
    one instead (Clopper-Pearson, `exact` is true), as `diagrams.sweeps.summary.rate` gives it; no false alarm at all
    that of Poisson's law (Garwood's).
    """
    n, found = len(episodes.scene), dict[str, dict[str, Any] | None]()
    asked = {name: value for name, value in statistics(episodes, of).items() if names is None or name in names}
    if not n:
        return dict.fromkeys(asked)
    runs, used = resampled(episodes.scene)
    positive = getattr(episodes, of)
    silent = ~episodes.noticed & (episodes.false_alarms == 0)
    rates = {"tpr": (episodes.noticed, positive), "tnr": (silent, ~positive)}
    if episodes.success is not None:
        rates["tasks"] = episodes.success, np.ones(n, bool)
    values = {name: float(statistic(np.ones(n))) for name, statistic in asked.items()}
    said = {name: asked[name] for name, value in values.items() if not np.isnan(value)}
    parts = [{name: statistic(weights) for name, statistic in said.items()} for weights in _weights(runs, used, n)]
    for name, value in values.items():
        if name not in said:
            found[name] = None
            continue
        low, high = np.nanquantile(np.concatenate([part[name] for part in parts]), (0.025, 0.975))
        found[name] = {"value": value, "interval": [float(low), float(high)], "exact": False}
        if name in rates and value in (0.0, 1.0):
            right, which = rates[name]
            exact = rate(right[which], episodes.scene[which], episodes.training_seed[which])
            found[name] = {"value": value, "interval": exact["interval"], "exact": True}
        if name == "false_alarms_per_hour" and value == 0.0:
            most = -np.log(0.025) * HOUR / episodes.normal_time.sum()
            found[name] = {"value": value, "interval": [0.0, float(most)], "exact": True}
    return found


def _weights(runs: np.ndarray, used: np.ndarray, n: int, parts: int = 16) -> Iterator[np.ndarray]:
    """How often each of n episodes is in each draw of `resampled`, (draws, n), in so many parts: all are too many."""
    for some, kept in zip(np.array_split(runs, parts), np.array_split(used, parts), strict=True):
        places = some + n * np.arange(len(some))[:, None, None]
        yield np.bincount(places.ravel(), kept.ravel(), minlength=len(some) * n).reshape(-1, n)


def severity_noticed_by_half(severity: np.ndarray, noticed: np.ndarray, scene: np.ndarray) -> dict[str, Any] | None:
    """The severity at which half of the episodes are noticed, `value`, and its 95 % `interval`; (n,) arrays.

    Of the shares at each severity, made monotonic (isotonic regression), the first crossing of 1/2, interpolated. None
    where half is never noticed; where it is at the least severity already, that one. A draw without a crossing counts
    as beyond the largest severity: so a bound may be None.
    """
    levels, index = np.unique(severity, return_inverse=True)

    def crossing(weights: np.ndarray) -> float:
        sums = np.bincount(index, weights, len(levels))
        there = sums > 0.0
        shares = np.bincount(index, weights * noticed, len(levels))[there] / sums[there]
        rising = isotonic_regression(shares, weights=sums[there]).x
        above = np.flatnonzero(rising >= 0.5)
        if not len(above):
            return np.inf
        first, at = above[0], levels[there]
        if first == 0:
            return float(at[0])
        step = (0.5 - rising[first - 1]) / (rising[first] - rising[first - 1])
        return float(at[first - 1] + step * (at[first] - at[first - 1]))

    value = crossing(np.ones(len(severity)))
    if np.isinf(value):
        return None
    runs, used = resampled(scene)
    drawn = [
        crossing(np.bincount(r[u], minlength=len(severity)).astype(float)) for r, u in zip(runs, used, strict=True)
    ]
    low, high = np.quantile(drawn, (0.025, 0.975), method="inverted_cdf")
    return {"value": value, "interval": [None if np.isinf(bound) else float(bound) for bound in (low, high)]}
