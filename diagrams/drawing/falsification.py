"""The course of the searches for a perturbation that defeats the controller, and all trials by size and length."""

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save
from diagrams.episodes.switching import DEFEATS

STYLES = (("o", ORANGE), ("s", RED), ("^", BLUE), ("D", GREEN))
MARKS = {None: (".", "0.6")} | dict(zip(DEFEATS, STYLES, strict=True))


def save_search(trials: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """The best objective so far of each sampler (below 1: a counterexample's magnitude), and all trials.

    `trials`: by sampler, each with `objective`, `failure` (a key of MARKS), `moved_deg` and `length_ticks`.
    """
    figure, (left, right) = new_figure(1, 2, figsize=(12, 4.6))
    for (name, row), colour in zip(trials.items(), (BLUE, RED, GREEN), strict=False):
        best = np.fmin.accumulate([t["objective"] for t in row] or [np.nan])
        left.step(np.arange(1, len(best) + 1), best, where="post", color=colour, marker=".", label=name)
    left.axhline(1.0, color="0.5", lw=0.8, ls="--")
    longest = max(map(len, trials.values()), default=0)
    left.set(xlim=(0, longest + 1), ylim=(0, 2), xlabel="trials", ylabel="best objective so far")
    left.set_title("below 1: magnitude of a counterexample; above: 1 + margin to one", fontsize=9)
    left.legend()
    for kind, (mark, colour) in MARKS.items():
        chosen = [(t["moved_deg"], t["length_ticks"]) for row in trials.values() for t in row if t["failure"] == kind]
        label = f"{kind or 'withstood'} ({len(chosen)})"
        right.plot(*np.reshape(chosen, (-1, 2)).T, mark, color=colour, ls="", label=label)
    right.set(xlabel="size (deg, norm over the joints)", ylabel="length (ticks)")
    right.legend(fontsize=8)
    save(figure, path)
