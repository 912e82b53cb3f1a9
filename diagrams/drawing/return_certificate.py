"""The certificate of mode `return`: V over time, and from where a straight path home touches something."""

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save

TOUCHED = {"desk": ORANGE, "shelf": GREEN, "can_to_pick": RED, "can_on_shelf": "purple"}


def save_certificate(data: dict[str, Any], path: Path) -> None:
    """Draws V against the certified rate (left) and the starts, from above and from the side.

    Args:
        data: `values`, V at the ticks of each trajectory from inside the set; its `level`, that `at_home`, `rate` a
            tick, `period` s; `home` (3,), grasp frame at home, m; `grid`, two corners of the cans' area; `inside` and
            `outside`: `hands` (n, 3) m, `touches`, names of models or None, and outside `failed` (n,) bool.
    """
    from matplotlib.patches import Rectangle

    figure, (left, above, side) = new_figure(1, 3, figsize=(15, 4.6))
    _draw_values(left, data)
    for axis, vertical, title in ((above, 1, "from above"), (side, 2, "from the side")):
        _draw_starts(axis, data, vertical)
        axis.set_title(f"where the hand starts, {title}", fontsize=10)
    corner, opposite = data["grid"]
    above.add_patch(Rectangle(corner, *(opposite - corner), fill=False, ls=":", ec="0.4"))
    above.annotate("cans", (opposite[0], corner[1]), fontsize=7, color="0.4", ha="right", va="top")
    above.legend(fontsize=7, loc="best")
    save(figure, path)


def _draw_values(axis: Any, data: dict[str, Any]) -> None:
    length = max(len(v) for v in data["values"])
    rows = np.array([np.append(v, np.full(length - len(v), np.nan)) for v in data["values"]]) / data["level"]
    time = data["period"] * np.arange(length)
    counted = np.sum(np.isfinite(rows), axis=0) >= max(1, len(rows) // 50)
    low, middle, high = np.nanquantile(rows[:, counted], [0.0, 0.5, 1.0], axis=0)
    axis.fill_between(time[counted], low, high, color=BLUE, alpha=0.25, lw=0, label="all postures")
    axis.semilogy(time[counted], middle, color=BLUE, label="median")
    axis.semilogy(time, data["rate"] ** np.arange(length), color=RED, ls="--", label="certified")
    home = data["at_home"] / data["level"]
    axis.axhline(home, color="0.5", lw=0.8, ls=":")
    axis.text(time[-1], 1.15 * home, "at home", ha="right", fontsize=8, color="0.4")
    axis.set(ylim=(1e-3, 2), xlabel="time (s)", ylabel="V / level of the set")
    axis.legend(fontsize=8, loc="lower left")
    axis.set_title(f"trajectories home from {len(rows)} postures inside the set", fontsize=10)


def _draw_starts(axis: Any, data: dict[str, Any], vertical: int) -> None:
    def mark(group: str, chosen: np.ndarray, marker: str, label: str, **style: Any) -> None:
        points = data[group]["hands"][chosen][:, [0, vertical]].T
        axis.plot(*points, marker, label=f"{group}, {label} ({chosen.sum()})", **style)

    touched = {group: np.array([name or "" for name in data[group]["touches"]]) for group in ("inside", "outside")}
    mark("outside", np.asarray(data["outside"]["failed"], bool), "x", "fails", color="0.5", ms=4)
    mark("inside", touched["inside"] == "", ".", "clear", color=BLUE, ms=2, alpha=0.4)
    for group, marker in (("inside", "."), ("outside", "^")):
        for name, colour in TOUCHED.items():
            if name in touched[group]:
                mark(group, touched[group] == name, marker, f"path touches {name}", color=colour, ms=5)
    axis.plot(*data["home"][[0, vertical]], "k+", ms=10, label="initial posture")
    axis.set_aspect("equal", adjustable="datalim")
    axis.set(xlabel="x (m)", ylabel=f"{'xyz'[vertical]} (m)")
