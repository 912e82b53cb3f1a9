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

    The alarms are those from the onset on, without a fault all; of the recoveries it is the first, named below.

    Args:
        summary: what summary.json has.
        families: by fault; each family's rows stand together, those without one first.
    """
    first = summary["cells"][0]["recovery"]
    cells = {(c["fault"], c["severity"], c["detector"]): c for c in summary["cells"] if c["recovery"] == first}
    detectors = list(dict.fromkeys(name for *_, name in cells))
    found = list(dict.fromkeys((fault, severity) for fault, severity, _ in cells))
    order = ["", *dict.fromkeys(families.values())]
    rows = sorted(found, key=lambda row: order.index(families.get(row[0], "")))  # stable
    judging = [name for name in detectors if name not in ("never", "oracle")]
    acting = [name for name in detectors if any(c["tasks"] for (*_, own), c in cells.items() if own == name)]
    noticed = np.array([[_alarms(cells.get((*row, name))) for name in judging] for row in rows]).reshape(len(rows), -1)
    tasks = np.array([[_value(cells.get((*row, name)), "tasks") for name in acting] for row in rows])
    columns = max(len(judging), 1), len(acting)
    figure, (left, right) = new_figure(
        1, 2, figsize=(2.2 + COLUMN * sum(columns), 1.9 + ROW * len(rows)), width_ratios=columns
    )
    names = [fault if severity is None else f"{fault} {severity:g}" for fault, severity in rows]
    _map(left, noticed, judging, "Blues", "alarm, % of runs")
    _map(right, tasks, acting, "Greens", "tasks, %")
    right.set_xlabel(first, fontsize=7)
    left.set_yticks(range(len(rows)), names, fontsize=7)
    right.set_yticks([])
    between = [i for i in range(1, len(rows)) if families.get(rows[i][0]) != families.get(rows[i - 1][0])]
    for axes in (left, right):
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
