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
RADIUS, STACK = 0.48, 0.42  # of a state; between two words of an arrow


def save_cycle(found: dict[str, Any], path: Path) -> None:
    """Draws the report of the analysis `cycle`; the weakest arrow is red, the least known one named."""
    from matplotlib.patches import Circle

    figure, axis = new_figure(1, 1, figsize=(9.5, 6))
    axis.set(xlim=(-4.4, 3.4), ylim=(-1.9, 1.9), aspect="equal")
    axis.axis("off")
    for name, (words, place) in STATES.items():
        axis.add_patch(Circle(place, RADIUS, facecolor=BLUE, alpha=0.15, edgecolor=BLUE, lw=1.5))
        reset = RESET if name == "home" and found["rule"] == "reset" else ""
        axis.text(*place, words + reset, ha="center", va="center", fontsize=9)
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for arrow in found["arrows"]:
        groups.setdefault((arrow["from"], arrow["to"]), []).append(arrow)
    for (begin, end), arrows in groups.items():
        colour = RED if any(arrow["name"] == found["weakest"] for arrow in arrows) else "0.2"
        style = {"arrowstyle": "-|>", "lw": 1.6, "mutation_scale": 15, "color": colour, "shrinkA": 0, "shrinkB": 0}
        start, stop = np.array(STATES[begin][1]), np.array(STATES[end][1])
        if begin == end:
            edges = (start + RADIUS * np.array([-0.85, side * 0.53]) for side in (1.0, -1.0))
            axis.annotate("", next(edges), next(edges), arrowprops=style | {"connectionstyle": "arc3,rad=-1.6"})
            place, align, first = start + np.array([-1.0, 0.0]), "right", 0.5 * (len(arrows) - 1)
        else:
            along = (stop - start) / np.linalg.norm(stop - start)
            axis.annotate("", stop - RADIUS * along, start + RADIUS * along, arrowprops=style)
            middle = 0.5 * (start + stop)
            place, align = middle + 0.16 * middle / np.linalg.norm(middle), "left" if middle[0] > 0 else "right"
            first = 0 if middle[1] < 0 else len(arrows) - 1  # away from the ring
        for number, arrow in enumerate(arrows):
            least = " (least known)" if arrow["name"] == found["least_known"] else ""
            words = f"{arrow['name']}{least}\n{arrow['failures']} of {arrow['samples']}, at most {arrow['bound']:.1e}"
            height = place[1] + STACK * (first - number)
            colour = RED if arrow["name"] == found["weakest"] else "0.2"
            axis.text(place[0], height, words, ha=align, va="center", fontsize=8.5, color=colour)
    axis.set_title(f"failures of samples, and at most (95 %); the weakest arrow: {found['weakest']}", fontsize=10)
    save(figure, path)
