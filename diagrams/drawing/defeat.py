"""The climb of splitting to a defeat, and where the defeats lie."""

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, RED, new_figure, save

COLOURS = {"A": BLUE, "B": RED}
STRENGTH = {"A": ("moved_deg", "size of the move (deg, norm over the joints)"), "B": ("hold", "stop (ticks)")}


def save_defeat(found: dict[str, dict[str, Any]], path: Path) -> None:
    """`found`: by kind its `report` and its `cases`; one picture of the stages, and one a kind of the moments."""
    figure, axes = new_figure(1, 1 + len(found), figsize=(4.6 * (1 + len(found)), 4.4))
    climb, *others = np.atleast_1d(axes)
    for kind, entry in found.items():
        for i, run in enumerate(entry["report"]["repetitions"]):
            levels = [max(stage["level"], 0.0) for stage in run["stages"]] + [1.0]
            above = np.cumprod([stage["share"] for stage in run["stages"]]).tolist() + [run["estimate"]]
            shown = [(level, share) for level, share in zip(levels, above, strict=True) if share > 0.0]
            climb.plot(*np.reshape(shown, (-1, 2)).T, color=COLOURS[kind], marker=".", lw=1, label=None if i else kind)
        if (brute := entry["report"]["brute"]) is not None:
            bars = [(max(part["level"], 0.0), part["brute"]) for part in entry["report"]["above"]]
            for at, counted in [*bars, (1.03 if kind == "A" else 1.06, brute)]:
                ends = np.maximum(counted["interval"], 1e-6)
                climb.plot([at, at], ends, color=COLOURS[kind], lw=4, alpha=0.4, solid_capstyle="butt")
    climb.set(yscale="log", xlabel="severity (1: defeated)", ylabel="probability of more")
    climb.set_title("each line a repetition; bars: brute force", fontsize=9)
    climb.legend()
    for (kind, entry), axis in zip(found.items(), others, strict=True):
        name, label = STRENGTH[kind]
        for defeated, (mark, colour) in {False: (".", "0.75"), True: ("o", COLOURS[kind])}.items():
            for subtask, fill in ((1, "none"), (2, colour)):
                chosen = [
                    (100 * given.level, case.moved_deg if name == "moved_deg" else given.hold_ticks)
                    for case in entry["cases"]
                    if (given := case.episode.disturbance).subtask == subtask and (case.level >= 1.0) == defeated
                ]
                word = f"{'defeated' if defeated else 'withstood'}, subtask {subtask} ({len(chosen)})"
                axis.plot(
                    *np.reshape(chosen, (-1, 2)).T, mark, ls="", color=colour, markerfacecolor=fill, ms=5, label=word
                )
        axis.set(xlabel="begins so far from the goal (cm)", ylabel=label, title=f"disturbance {kind}")
        axis.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    save(figure, path)
