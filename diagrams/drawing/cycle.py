"""The cycle as a ring of states, each arrow with its count and bound."""

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, RED, new_figure, save

# Name of the state in the report, what it says, and where it stands.
STATES = {
    "task": ("task\n" r"$\alpha<1/2$", (-1.5, 0.0)),
    "return": ("return\n" r"$\alpha\geq 1/2$", (0.0, 1.2)),
    "box": ("certified box\n" r"$V\leq 1$", (1.5, 0.0)),
    "home": ("home", (0.0, -1.2)),
}
RESET = "\n" r"$c:=c_0$"
RADIUS = 0.48


def save_cycle(found: dict[str, Any], path: Path) -> None:
    """Draws the report of the analysis `cycle`; the weakest arrow is red."""
    from matplotlib.patches import Circle

    figure, axis = new_figure(1, 1, figsize=(9.5, 6))
    axis.set(xlim=(-4.2, 3.2), ylim=(-1.9, 1.9), aspect="equal")
    axis.axis("off")
    for name, (words, place) in STATES.items():
        axis.add_patch(Circle(place, RADIUS, facecolor=BLUE, alpha=0.15, edgecolor=BLUE, lw=1.5))
        reset = RESET if name == "home" and found["rule"] == "reset" else ""
        axis.text(*place, words + reset, ha="center", va="center", fontsize=9)
    loops = 0
    for arrow in found["arrows"]:
        colour = RED if arrow["name"] == found["weakest"] else "0.2"
        style = {"arrowstyle": "-|>", "lw": 1.6, "mutation_scale": 15, "color": colour, "shrinkA": 0, "shrinkB": 0}
        words = f"{arrow['name']}\n{arrow['failures']} of {arrow['samples']}, at most {arrow['bound']:.1e}"
        start, end = (np.array(STATES[arrow[side]][1]) for side in ("from", "to"))
        if arrow["from"] == arrow["to"]:
            side = 1.0 if loops == 0 else -1.0
            loops += 1
            edge = start + RADIUS * np.array([-0.92, 0.38 * side])
            axis.annotate("", start + RADIUS * np.array([-0.38, 0.92 * side]), edge,
                          arrowprops=style | {"connectionstyle": f"arc3,rad={-1.2 * side}"})  # fmt: skip
            axis.text(-2.25, 0.62 * side, words, ha="right", va="center", fontsize=8.5, color=colour)
            continue
        along = (end - start) / np.linalg.norm(end - start)
        axis.annotate("", end - RADIUS * along, start + RADIUS * along, arrowprops=style)
        middle = 0.5 * (start + end)
        away = middle + 0.16 * middle / np.linalg.norm(middle)
        axis.text(*away, words, ha="left" if middle[0] > 0 else "right", va="center", fontsize=8.5, color=colour)
    axis.set_title(f"failures of samples, and at most (95 %); the weakest arrow: {found['weakest']}", fontsize=10)
    save(figure, path)
