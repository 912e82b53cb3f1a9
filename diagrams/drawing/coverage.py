"""What the calibration promises and what fresh runs say: false alarms, coverage of resampled calibrations, a band."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save

MOST_CURVES = 60  # that are drawn
GAP = 12  # ticks between the subtasks


def save_coverage(found: Mapping[str, Any], example: Mapping[str, Any], path: Path) -> None:
    """Draws, a column a delta: false alarms by detector, coverage over resampled calibrations, a detector's band.

    Args:
        found: what coverage.json has.
        example: `label` of the detector; `mean`, `scale` of its band, (P,) of each subtask; `gammas` of the band and
            `constant` ones, of each delta; `curves`: phases (T, 2) and errors by their mean (T,) of fresh runs.
    """
    deltas = list(dict.fromkeys(cell["delta"] for cell in found["cells"]))
    labels = list(dict.fromkeys(cell["detector"] for cell in found["cells"]))
    height = 7.4 + 0.24 * len(labels)
    figure, axes = new_figure(3, len(deltas), figsize=(1.2 + 3.6 * len(deltas), height), squeeze=False)
    for column, delta in enumerate(deltas):
        cells = [cell for cell in found["cells"] if cell["delta"] == delta]
        _false_alarms(axes[0, column], cells, first=not column)
        _resampled(axes[1, column], cells)
        _band(axes[2, column], example, column)
        axes[0, column].set_title(f"delta = {delta:.3g}", fontsize=10)
    axes[1, 0].set_ylabel("probability")
    axes[2, 0].set_ylabel(f"{example['label']}: error by its mean")
    save(figure, path)


def _false_alarms(axes: Any, cells: list[Mapping[str, Any]], first: bool) -> None:
    """Shares of false alarms, and where they lie if the promise holds."""
    low, high = (bound / cells[0]["constant"]["n"] for bound in cells[0]["constant"]["expected"])
    axes.axvspan(low, high, color="0.9", label="95 % of the counts, if kept")
    axes.axvline(cells[0]["delta"], color=RED, lw=0.8, ls=":", label="delta")
    for name, colour, shift in (("constant", BLUE, -0.15), ("band", ORANGE, 0.15)):
        shares = np.array([cell[name]["false_alarms"] / cell[name]["n"] for cell in cells])
        intervals = np.array([cell[name]["interval"] for cell in cells]).T
        errors = np.abs(intervals - shares)
        places = np.arange(len(cells)) + shift
        axes.errorbar(shares, places, xerr=errors, fmt=".", ms=4, lw=0.8, color=colour, label=name)
    axes.set(xlabel="share of fresh runs with a false alarm", ylim=(len(cells) - 0.5, -0.5), xlim=(0.0, None))
    axes.set_yticks(range(len(cells)), [cell["detector"] for cell in cells] if first else [], fontsize=8)
    if first:
        axes.legend(fontsize=7, loc="best")


def _resampled(axes: Any, cells: list[Mapping[str, Any]]) -> None:
    """Coverage over resampled calibrations: a line a detector, all in bars, and the laws."""
    from scipy.stats import beta, betabinom

    own = cells[0]["resampled"]
    rest, promised = own["n"], cells[0]["constant"]["promised"]
    count = cells[0]["constant"]["allowed"]
    kept = cells[0]["constant"]["of"] + 1 - count
    everything = [np.array(cell["resampled"]["covered"]) / rest for cell in cells]
    lowest = min(float(shares.min()) for shares in everything)
    wide = float(betabinom(rest, kept, count).ppf(0.001)) / rest
    step = max(round((1.0 - min(lowest, wide)) * rest / 25), 1)
    edges = 1.0 + (0.5 - step * np.arange(27)[::-1]) / rest
    edges = edges[edges > -(step + 0.5) / rest]  # the last one below 0 is the first
    for shares in everything:
        height, _ = np.histogram(shares, edges)
        axes.stairs(height / len(shares), edges, color=BLUE, lw=0.5, alpha=0.4)
    height, _ = np.histogram(np.concatenate(everything), edges)
    axes.stairs(height / sum(map(len, everything)), edges, fill=True, color=BLUE, alpha=0.25, label="resampled")
    exact = np.diff(betabinom(rest, kept, count).cdf(np.floor(edges * rest)))
    axes.stairs(exact, edges, color=RED, lw=1.2, label="beta-binomial")
    x = np.linspace(edges[0], 1.0, 200)
    axes.plot(x, beta(kept, count).pdf(x) * step / rest, color=GREEN, lw=1.0, label="Beta")
    axes.axvline(1.0 - promised, color="0.5", lw=0.8, ls=":")
    axes.set(xlabel="coverage of the other runs", xlim=(edges[0], min(edges[-1], 1.0 + 0.5 / rest)))
    axes.legend(fontsize=7, loc="upper left")


def _band(axes: Any, example: Mapping[str, Any], column: int) -> None:
    """Fresh runs over the phase, subtask 1 and then 2, with both thresholds."""
    starts = (0, len(example["mean"][0]) + GAP)
    for phase, ratio in example["curves"][:MOST_CURVES]:
        for subtask, start in enumerate(starts):
            own, last = phase[:, 0] == subtask, len(example["mean"][subtask]) - 1
            at = np.minimum(phase[own, 1], last)
            axes.plot(start + at, ratio[own], ",", color="0.6", alpha=0.6)
    for subtask, start in enumerate(starts):
        mean, scale = example["mean"][subtask], example["scale"][subtask]
        upper = mean + example["gammas"][column] * scale
        axes.plot(start + np.arange(len(mean)), mean, color=ORANGE, lw=0.8, ls="--")
        axes.plot(start + np.arange(len(mean)), upper, color=ORANGE, lw=1.2, label=None if subtask else "band")
    axes.axhline(example["constant"][column], color=BLUE, lw=1.2, label="constant")
    axes.set(xlabel="phase of subtask 1, then of 2 (ticks)", ylim=(0.0, None))
    axes.legend(fontsize=7, loc="best")
