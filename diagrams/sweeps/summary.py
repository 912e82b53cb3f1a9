"""Statistics of a sweep: rates with intervals, delays, failure kinds, paired comparisons, and the table of them."""

import collections
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from diagrams.sweeps.sequential import paired
from diagrams.world.names import DISTURBANCES
from systems.recoveries.registry import SHIPPED

CELL = ["rnn", "detector", "gamma", "disturbance", "severity", "recovery"]
# Measure: the column that says whether it went well, and what went wrong first. The last is the switching in the
# paper's words (diagrams/episodes/switching.py).
MEASURES = {
    "task": ("success", "failure"),
    "switching": ("switch_success", "switch_failure"),
    "as_paper": ("paper_switch_success", "switch_failure"),
}
DELAYS = ("detection_delay_s", "return_s", "resume_s")
ARM_TAKEN = DISTURBANCES[1:]
ONE_RETURN = 2  # crossings of the guard: up and down
DRAWS, BOOTSTRAP_SEED = 4000, 0


def rate(successes: np.ndarray, scenes: np.ndarray, training_seeds: np.ndarray) -> dict[str, Any]:
    """Of (n,) bool, of which scene and training seed each: n, successes, rate, and its 95 % interval.

    The interval is `bootstrap`'s, which has no width where all or none succeeded: there it is the exact one
    (Clopper-Pearson) of the scenes in which every training seed succeeded, and `exact` is true. That one is always in
    `scenes`. Mean and deviation over training seeds; the deviation is that of the whole (divided by the number of
    seeds): the paper's figures, such as 95.8 +- 2.4 % of three times 40, are possible with it alone.
    """
    n, count = len(successes), int(np.sum(successes))
    if not n:
        return {"n": 0, "successes": 0}
    by_scene = [bool(successes[scenes == scene].all()) for scene in np.unique(scenes)]
    bounds = binomtest(sum(by_scene), len(by_scene)).proportion_ci(method="exact")
    of_scenes = {"n": len(by_scene), "all_right": sum(by_scene), "interval": [float(bounds.low), float(bounds.high)]}
    by_seed = {str(seed): float(np.mean(successes[training_seeds == seed])) for seed in np.unique(training_seeds)}
    means = list(by_seed.values())
    exact = count in (0, n)
    return {
        "n": n,
        "successes": count,
        "rate": count / n,
        "interval": of_scenes["interval"] if exact else bootstrap(successes, scenes),
        "exact": exact,
        "scenes": of_scenes,
        "by_training_seed": by_seed,
        "mean": float(np.mean(means)),
        "deviation": float(np.std(means)),
    }


def bootstrap(successes: np.ndarray, scenes: np.ndarray) -> list[float]:
    """95 % percentile interval of the rate: draws scenes, and within each the runs of its training seeds."""
    runs, used = resampled(scenes)
    rates = np.where(used, successes[runs], 0.0).sum(axis=(1, 2)) / used.sum(axis=(1, 2))
    return [float(bound) for bound in np.quantile(rates, (0.025, 0.975))]


def resampled(scenes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """DRAWS draws of scenes, and of as many runs within each as it has; `scenes` (n,): of which scene a run is.

    Returns the runs that are drawn, (DRAWS, scenes, most runs of a scene) of 0 to n - 1, and which of these count.
    """
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    _, index, counts = np.unique(scenes, return_inverse=True, return_counts=True)
    order = np.argsort(index, kind="stable")
    first = np.cumsum(counts) - counts  # of the scene's runs, in that order
    drawn = rng.integers(len(counts), size=(DRAWS, len(counts)))
    size = counts[drawn]  # as many runs as the scene has
    within = rng.random((DRAWS, len(counts), counts.max()))
    runs = order[first[drawn][..., None] + (within * size[..., None]).astype(int)]
    return runs, np.arange(counts.max()) < size[..., None]


def spread(values: pd.Series) -> dict[str, float] | None:
    """Median, 95th percentile and count of the values there are; None without any."""
    values = values.dropna()
    if values.empty:
        return None
    return {"median": float(values.median()), "p95": float(values.quantile(0.95)), "n": len(values)}


def measures(rows: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Those of MEASURES that were asked for: --until switching leaves the others open, and so does a void episode."""
    run = rows[rows["error"].isna()]
    return {name: columns for name, columns in MEASURES.items() if run.empty or run[columns[0]].notna().any()}


def judged(rows: pd.DataFrame, flag: str, kind: str) -> dict[str, Any]:
    """The rate of the column `flag` where it says something, and how often what failed first, of the column `kind`."""
    rows = rows[rows[flag].notna()]
    successes = rows[flag].to_numpy(bool)
    failures = collections.Counter(rows[kind][~successes].dropna())
    found = rate(successes, rows["seed"].to_numpy(), rows["training_seed"].to_numpy())
    return found | {"failures": dict(failures.most_common())}


def cells(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """One entry a controller (over its training seeds) and disturbance; `rows`: a table (see table.py).

    A measure's `clear`: of the episodes alone whose straight way home touches nothing.
    """
    found = []
    for labels, cell in _groups(rows, CELL):
        void, run = cell["void"].eq(True), cell["error"].isna()
        clear = cell[cell["way_home_clear"].eq(True)]
        entry = labels | {
            "errors": int((~run).sum()),
            "void": int(void.sum()),
            "void_failures": dict(collections.Counter(cell["failure"][void].dropna()).most_common()),
        }
        for measure, columns in measures(cell).items():
            entry[measure] = judged(cell, *columns)
            if not clear.empty:
                entry[measure]["clear"] = judged(clear, *columns)
        # A false alarm that is under way at the onset would count as noticed at once.
        entry |= {name: spread(cell[name][cell["false_switches"] == 0]) for name in DELAYS}
        if labels["severity"] is not None:
            kept = cell[run & ~void]
            alarmed = kept["switched"].to_numpy(bool)
            entry["alarmed"] = rate(alarmed, kept["seed"].to_numpy(), kept["training_seed"].to_numpy())
        # A fault that takes the arm once says whether the arm returned, and whatever does not take it says nothing.
        if labels["disturbance"] in ARM_TAKEN or (labels["severity"] and cell["returned"].notna().any()):
            kept = cell[run & ~void]
            one = (kept["guard_crossings"] <= ONE_RETURN).to_numpy(bool)
            entry["one_return"] = rate(one, kept["seed"].to_numpy(), kept["training_seed"].to_numpy())
            gone = kept[kept["way_home_m"].notna()]
            free = (gone["way_home_m"] > 0.0).to_numpy(bool)
            entry["untouched"] = rate(free, gone["seed"].to_numpy(), gone["training_seed"].to_numpy())
            entry["way_home_m"] = float(gone["way_home_m"].min()) if len(gone) else None
        seconds = float(cell["sim_seconds"].sum())
        entry["needless_share"] = float(cell["needless_s"].sum()) / seconds if seconds else None
        entry["switched_again"] = int((cell["later_switches"] > 0).sum())
        found.append(entry | {name: spread(cell[name]) for name in ("sim_seconds", "realtime_factor")})
    return found


def comparisons(rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Each two controllers (rnn, detector) at the same gamma, on the episodes that both have and that say something.

    `p`: exact sign test on the scenes, which recur under every training seed: which of the two does better there more
    often (`scenes_a`, `scenes_b`). All pairs are listed; none of the p is corrected for their number. `e`: see
    sequential.py, valid however often the sweep was looked at and gone on with.
    """
    found = []
    for labels, group in _groups(rows, ["disturbance", "severity", "gamma"]):
        controllers = [(c["rnn"], c["detector"], part) for c, part in _groups(group, ["rnn", "detector"])]
        for (rnn_a, detector_a, a), (rnn_b, detector_b, b) in itertools.combinations(controllers, 2):
            pairs = a.merge(b, on=["training_seed", "seed"], suffixes=("_a", "_b"))
            for measure, (flag, _) in measures(group).items():
                both = pairs[pairs[f"{flag}_a"].notna() & pairs[f"{flag}_b"].notna()]
                more = both[f"{flag}_a"].astype(int) - both[f"{flag}_b"].astype(int)
                said = paired([(int(scene), int(d)) for scene, d in zip(both["seed"], more, strict=True)])
                names = {"a": {"rnn": rnn_a, "detector": detector_a}, "b": {"rnn": rnn_b, "detector": detector_b}}
                p = sign_test(said["scenes_a"], said["scenes_b"])
                found.append(labels | {"measure": measure} | names | said | {"p": p})
    return found


def sign_test(a: int, b: int) -> float:
    """Two-sided p of the exact sign test, `a` scenes against `b`."""
    return float(binomtest(a, a + b).pvalue) if a + b else 1.0


def _groups(rows: pd.DataFrame, columns: list[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Groups in the order in which they come, with plain labels (a missing gamma is None)."""
    # Tables of versions that knew no faults, or no recovery but the one that ships.
    rows = rows.assign(**{name: None for name in ("severity", "recovery") if name not in rows})
    rows = rows.assign(recovery=rows["recovery"].where(rows["recovery"].notna(), SHIPPED))
    for values, group in rows.groupby(columns, sort=False, dropna=False):
        yield {name: None if pd.isna(v) else v for name, v in zip(columns, values, strict=True)}, group


def table(summary: dict[str, Any]) -> str:
    """Cells and comparisons of a summary as text."""
    lines = [f"{'controller':24s} {'dist.':5s} {'':15s} {'rate and 95 % interval':33s} {'over seeds':15s} failed first"]
    for cell in summary["cells"]:
        for measure in (name for name in MEASURES if name in cell):
            lines.append(f"{controller_name(cell):24s} {disturbance_name(cell):5s} {_rate(measure, cell[measure])}")
            if "clear" in cell[measure]:
                lines.append(f"{'':30s} {_rate('way home clear', cell[measure]['clear'])}")
        if cell["void"]:
            kinds = f" ({_kinds(cell['void_failures'])})" if cell["void_failures"] else ""
            lines.append(f"{'':30s} void, since the disturbance never came: {cell['void']}{kinds}")
        if "alarmed" in cell:
            lines.append(f"{'':30s} {_rate('alarm', cell['alarmed'])}")
        if "one_return" in cell:
            lines.append(f"{'':30s} {_rate('one return', cell['one_return'])}")
            nearest = "" if cell["way_home_m"] is None else f"  nearest {100 * cell['way_home_m']:.1f} cm"
            lines.append(f"{'':30s} {_rate('touches nothing', cell['untouched'])}{nearest}")
        lost = [f"{100 * cell['needless_share']:.2f} % of the time"] if cell["needless_share"] else []
        lost += [f"switched again in {cell['switched_again']} runs"] if cell["switched_again"] else []
        if lost:
            lines.append(f"{'':30s} needless returns: {'; '.join(lost)}")
        delays = [
            f"{word} {cell[name]['median']:.1f} s, {cell[name]['p95']:.1f} s"
            for word, name in zip(("noticed after", "home after", "alpha low after"), DELAYS, strict=True)
            if cell[name] is not None
        ]
        if delays:
            lines.append(f"{'':30s} median, p95: {'; '.join(delays)}")
    for c in summary["comparisons"]:
        lines.append(
            f"{disturbance_name(c):5s} {c['measure']:9s} {controller_name(c['a'] | {'gamma': c['gamma']})} against "
            f"{controller_name(c['b'] | {'gamma': None})}: of {c['n']} only the first {c['only_a']}, only the second "
            f"{c['only_b']}; of {c['scenes']} scenes {c['scenes_a']} and {c['scenes_b']}, p = {c['p']:.2g}"
        )
    lines.append(
        f"Intervals: bootstrap of {DRAWS} draws of scenes and, within them, of training seeds; e: exact, of the scenes "
        "in which every training seed is right, since a bootstrap of 0 or 100 % has no width."
    )
    return "\n".join(lines)


def _rate(words: str, r: dict[str, Any]) -> str:
    if not r["n"]:
        return f"{words:15s}    0 of    0"
    low, high = r["interval"]
    return (
        f"{words:15s} {r['successes']:4d} of {r['n']:4d} {100 * r['rate']:6.1f} % "
        f"[{100 * low:5.1f}, {100 * high:5.1f}]{'e' if r['exact'] else ' '} "
        f"{100 * r['mean']:5.1f} ± {100 * r['deviation']:4.1f} %  {_kinds(r.get('failures', {}))}"
    ).rstrip()


def _kinds(failures: dict[str, int]) -> str:
    return ", ".join(f"{kind} {count}" for kind, count in failures.items())


def disturbance_name(labels: dict[str, Any]) -> str:
    """For people: A, or camera_shift 0.5."""
    return labels["disturbance"] + ("" if labels.get("severity") is None else f" {labels['severity']:g}")


def controller_name(labels: dict[str, Any]) -> str:
    """For people: LSTM recall, or LSTM recall gamma 3, or LSTM recall backoff."""
    gamma = "" if labels["gamma"] is None else f" gamma {labels['gamma']:g}"
    recovery = labels.get("recovery", SHIPPED)
    return f"{labels['rnn'].upper()} {labels['detector']}{gamma}{'' if recovery == SHIPPED else f' {recovery}'}"
