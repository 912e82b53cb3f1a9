"""The guard surface over two directions of posture displacement."""

from pathlib import Path

import numpy as np

from diagrams.drawing.style import BLUE, RED, new_figure, save
from diagrams.episodes.switching import GUARD


def save_guard(report: dict, title: str, path: Path) -> None:
    """Filled contours of the largest error over gamma (alpha = 1/2 where it is 1), the modes and the bisected points.

    `report`: of the analysis `guard`; NaN in its `alpha` and `errors` where the arm cannot be.
    """
    figure, axis = new_figure(figsize=(7.6, 6.2))
    x, alpha, errors = (np.array(report[name]) for name in ("coordinates_deg", "alpha", "errors"))
    values = np.ma.masked_invalid(np.log10(np.maximum(errors, 1e-9) / report["gamma"]))
    reach = max(float(np.abs(values).max()) if values.count() else 1.0, 0.1)
    filled = axis.contourf(x, x, values, levels=np.linspace(-reach, reach, 25), cmap="RdBu_r")
    figure.colorbar(filled, ax=axis, label=r"$\log_{10}\,\max_n (l_n/\overline{l}_n)\,/\,\gamma$")
    if values.count() and values.min() < 0 < values.max():
        axis.contour(x, x, values, levels=[0.0], colors="k", linewidths=1.8)
    box = {"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 2}
    for mode, colour, chosen in (("task", BLUE, alpha < GUARD), ("return", RED, alpha >= GUARD)):
        if chosen.any():
            # The point of the region that is farthest from everything else, and from the frame, carries the name.
            inside, others = np.argwhere(chosen), np.argwhere(~np.pad(chosen, 1)) - 1
            far = [np.min(np.linalg.norm(others - point, axis=1)) for point in inside]
            j, i = inside[int(np.argmax(far))]
            axis.text(x[i], x[j], mode, ha="center", va="center", color=colour, fontsize=13, weight="bold", bbox=box)
    if points := report["bisected_points_deg"]:
        axis.plot(*np.array(points).T, "o", color="k", mfc="yellow", ms=5, label=r"$\alpha = 1/2$ by bisection")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), fontsize=8)
    axis.set_facecolor("0.85")  # where the arm cannot be
    first, second = report["joints"]
    axis.set(xlabel=f"displacement of joint {first} (deg)", ylabel=f"displacement of joint {second} (deg)")
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=10)
    save(figure, path)
