"""The bench at a glance: which detector notices which fault, and what tasks are done with those that act."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import new_figure, save

ROW, COLUMN = 0.2, 0.42  # inches
Row = tuple[str, float | None]  # fault, severity


def save_bench(summary: Mapping[str, Any], families: Mapping[str, str], path: Path) -> None:
    """Draws, a row a fault and severity: share of the runs with an alarm by detector, and of the tasks done.

    The alarms are those from the onset on, without a fault all. The tasks stand apart by recovery, named below; those
    of `never`, which none comes after, with the first.

    Args:
        summary: what summary.json has.
        families: by fault; each family's rows stand together, those without one first.
    """
    cells = {(c["fault"], c["severity"], c["detector"], c["recovery"]): c for c in summary["cells"]}
    recoveries = list(dict.fromkeys(recovery for *_, recovery in cells))
    detectors = list(dict.fromkeys(name for _, _, name, _ in cells))
    found = list(dict.fromkeys((fault, severity) for fault, severity, *_ in cells))
    order = ["", *dict.fromkeys(families.values())]
    rows = sorted(found, key=lambda row: order.index(families.get(row[0], "")))  # stable
    judging = [name for name in detectors if name not in ("never", "oracle")]
    acted = {(name, recovery) for (_, _, name, recovery), c in cells.items() if c["tasks"]}
    acting = [
        [name for name in detectors if (name, recovery) in acted and (name != "never" or recovery == recoveries[0])]
        for recovery in recoveries
    ]
    noticed = [[_alarms(cells.get((*row, name, recoveries[0]))) for name in judging] for row in rows]
    columns = [max(len(names), 1) for names in (judging, *acting)]
    figure, (left, *right) = new_figure(
        1, len(columns), figsize=(2.2 + COLUMN * sum(columns), 1.9 + ROW * len(rows)), width_ratios=columns
    )
    names = [fault if severity is None else f"{fault} {severity:g}" for fault, severity in rows]
    _map(left, np.array(noticed).reshape(len(rows), -1), judging, "Blues", "alarm, % of runs")
    for axes, recovery, own in zip(right, recoveries, acting, strict=True):
        tasks = [[_value(cells.get((*row, name, recovery)), "tasks") for name in own] for row in rows]
        _map(axes, np.array(tasks).reshape(len(rows), -1), own, "Greens", "tasks, %" if axes is right[0] else "")
        axes.set_xlabel(recovery, fontsize=7)
        axes.set_yticks([])
    left.set_yticks(range(len(rows)), names, fontsize=7)
    between = [i for i in range(1, len(rows)) if families.get(rows[i][0]) != families.get(rows[i - 1][0])]
    for axes in (left, *right):
        for i in between:
            axes.axhline(i - 0.5, color="black", lw=0.8)
    save(figure, path)


def _value(cell: Mapping[str, Any] | None, name: str) -> float:
    entry = cell and cell[name]
    return entry["value"] if entry else np.nan


def _alarms(cell: Mapping[str, Any] | None) -> float:
    """Share of the cell's runs with an alarm: of the disturbed ones, or false ones where none is."""
    if cell and cell["disturbed"]["tpr"] is None:
        return 1.0 - _value(cell["disturbed"], "tnr")
    return _value(cell and cell["disturbed"], "tpr")


def _map(axes: Any, shares: np.ndarray, names: list[str], colours: str, title: str) -> None:
    """Shares (rows, names) as colours with their percents; grey where there is none."""
    axes.set_facecolor("0.85")
    if names:
        axes.imshow(shares, cmap=colours, vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), share in np.ndenumerate(shares):
        if not np.isnan(share):
            axes.text(
                j,
                i,
                f"{100 * share:.0f}",
                ha="center",
                va="center",
                fontsize=6,
                color="white" if share > 0.6 else "black",
            )
    axes.set_xticks(range(len(names)), names, rotation=60, ha="left", rotation_mode="anchor", fontsize=7)
    axes.xaxis.tick_top()
    axes.set_title(title, fontsize=9)
