"""Statistics of a sweep: rates with intervals, delays, failure kinds, paired comparisons, and the table of them."""

import collections
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

CELL = ["rnn", "detector", "gamma", "disturbance"]
# Measure: the column that says whether it went well, and why not. The last is the switching in the paper's words
# (diagrams/episodes/switching.py).
MEASURES = {
    "task": ("success", "failure"),
    "switching": ("switch_success", "switch_failure"),
    "as_paper": ("paper_switch_success", "switch_failure"),
}

DELAYS = ("detection_delay_s", "return_s", "resume_s")


def rate(successes: np.ndarray, training_seeds: np.ndarray) -> dict[str, Any]:
    """Of (n,) bool and (n,) int: n, successes, rate, Wilson 95 % interval; mean and deviation over training seeds.

    The deviation is that of the whole (divided by the number of seeds): the paper's figures, such as 95.8 +- 2.4 % of
    three times 40, are possible with it alone.
    """
    n, count = len(successes), int(np.sum(successes))
    interval = binomtest(count, n).proportion_ci(method="wilson")
    by_seed = {str(seed): float(np.mean(successes[training_seeds == seed])) for seed in np.unique(training_seeds)}
    means = list(by_seed.values())
    return {
        "n": n,
        "successes": count,
        "rate": count / n,
        "interval": [float(interval.low), float(interval.high)],
        "by_training_seed": by_seed,
        "mean": float(np.mean(means)),
        "deviation": float(np.std(means)),
    }


def spread(values: pd.Series) -> dict[str, float] | None:
    """Median, 95th percentile and count of the values there are; None without any."""
    values = values.dropna()
    if values.empty:
        return None
    return {"median": float(values.median()), "p95": float(values.quantile(0.95)), "n": len(values)}


def measures(rows: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Those of MEASURES that were asked for: --until switching leaves the others open."""
    return {measure: columns for measure, columns in MEASURES.items() if rows[columns[0]].notna().all()}


def cells(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """One entry a controller (over its training seeds) and disturbance; `rows`: a table (see table.py)."""
    found, measured = [], measures(rows)
    for labels, cell in _groups(rows, CELL):
        entry = labels | {"errors": int(cell["error"].notna().sum())}
        for measure, (flag, kind) in measured.items():
            failures = collections.Counter(cell[kind][~cell[flag].astype(bool)].dropna())
            entry[measure] = rate(cell[flag].to_numpy(bool), cell["training_seed"].to_numpy())
            entry[measure]["failures"] = dict(failures.most_common())
        # A false alarm that is under way at the onset would count as noticed at once.
        entry |= {name: spread(cell[name][cell["false_switches"] == 0]) for name in DELAYS}
        found.append(entry | {name: spread(cell[name]) for name in ("sim_seconds", "realtime_factor")})
    return found


def comparisons(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """McNemar's exact test of each two controllers (rnn, detector) at the same gamma, on the episodes that both have.

    `p_scenes`: an exact sign test on the scenes, which recur under every training seed: which of the two switches or
    does its task more often there. All pairs are listed; none of the p is corrected for their number.
    """
    found, measured = [], measures(rows)
    for labels, group in _groups(rows, ["disturbance", "gamma"]):
        controllers = [(c["rnn"], c["detector"], part) for c, part in _groups(group, ["rnn", "detector"])]
        for (rnn_a, detector_a, a), (rnn_b, detector_b, b) in itertools.combinations(controllers, 2):
            pairs = a.merge(b, on=["training_seed", "seed"], suffixes=("_a", "_b"))
            for measure, (flag, _) in measured.items():
                more = pairs[f"{flag}_a"].astype(int) - pairs[f"{flag}_b"].astype(int)
                more_on_scene = more.groupby(pairs["seed"]).sum()
                only_a, only_b = int((more > 0).sum()), int((more < 0).sum())
                scenes_a, scenes_b = int((more_on_scene > 0).sum()), int((more_on_scene < 0).sum())
                found.append(
                    labels
                    | {
                        "measure": measure,
                        "a": {"rnn": rnn_a, "detector": detector_a},
                        "b": {"rnn": rnn_b, "detector": detector_b},
                        "n": len(pairs),
                        "only_a": only_a,
                        "only_b": only_b,
                        "p": sign_test(only_a, only_b),
                        "scenes_a": scenes_a,
                        "scenes_b": scenes_b,
                        "p_scenes": sign_test(scenes_a, scenes_b),
                    }
                )
    return found


def sign_test(a: int, b: int) -> float:
    """Two-sided p of the exact sign test, `a` pairs against `b`; on discordant pairs it is McNemar's exact test."""
    return float(binomtest(a, a + b).pvalue) if a + b else 1.0


def _groups(rows: pd.DataFrame, columns: list[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Groups in the order in which they come, with plain labels (a missing gamma is None)."""
    for values, group in rows.groupby(columns, sort=False, dropna=False):
        yield {name: None if pd.isna(v) else v for name, v in zip(columns, values, strict=True)}, group


def table(summary: dict[str, Any]) -> str:
    """Cells and comparisons of a summary as text."""
    lines = [f"{'controller':24s} {'dist.':5s} {'':9s} {'rate and 95 % interval':33s} {'over seeds':15s} failures"]
    for cell in summary["cells"]:
        for measure in (name for name in MEASURES if name in cell):
            r = cell[measure]
            low, high = r["interval"]
            kinds = ", ".join(f"{kind} {count}" for kind, count in r["failures"].items()) or "none"
            lines.append(
                f"{controller_name(cell):24s} {cell['disturbance']:5s} {measure:9s} "
                f"{r['successes']:4d} of {r['n']:4d} {100 * r['rate']:6.1f} % [{100 * low:5.1f}, {100 * high:5.1f}]  "
                f"{100 * r['mean']:5.1f} ± {100 * r['deviation']:4.1f} %  {kinds}"
            )
        delays = [
            f"{word} {cell[name]['median']:.1f} s, {cell[name]['p95']:.1f} s"
            for word, name in (("noticed after", "detection_delay_s"), ("home after", "return_s"))
            if cell[name] is not None
        ]
        if delays:
            lines.append(f"{'':30s} median, p95: {'; '.join(delays)}")
    for c in summary["comparisons"]:
        lines.append(
            f"{c['disturbance']:5s} {c['measure']:9s} {controller_name(c['a'] | {'gamma': c['gamma']})} against "
            f"{controller_name(c['b'] | {'gamma': None})}: of {c['n']} only the first {c['only_a']}, only the second "
            f"{c['only_b']}, p = {c['p']:.2g} (over scenes {c['p_scenes']:.2g})"
        )
    return "\n".join(lines)


def controller_name(labels: dict[str, Any]) -> str:
    """For people: LSTM recall, or LSTM recall gamma 3."""
    gamma = "" if labels["gamma"] is None else f" gamma {labels['gamma']:g}"
    return f"{labels['rnn'].upper()} {labels['detector']}{gamma}"
