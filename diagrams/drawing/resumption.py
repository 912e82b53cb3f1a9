"""The time to resume: how long it takes by either rule, and how well it was foretold."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, ORANGE, RED, new_figure, save
from diagrams.episodes.switching import RESUME_SECONDS

COLOURS = {"reset": BLUE, "imagined": ORANGE}
LINES = {"pick": "-", "place": "--", "can taken": ":"}
WORDS = {"reset": "starts anew at home", "imagined": "imagines its way to the end"}


def save_resumption(rows: Sequence[Mapping[str, Any]], period: float, path: Path) -> None:
    """Draws, by rule and kind, the share of starts that have resumed over time (left); T against the time measured.

    `rows`: `rule`, `kind`, `foretold` and `resumed` of each start, see diagrams/hybrid/resumption.py; `period`: of the
    ticks, s.
    """
    figure, (left, right) = new_figure(1, 2, figsize=(11, 4.4))
    longest = RESUME_SECONDS
    for rule, colour in COLOURS.items():
        of_rule = [row for row in rows if row["rule"] == rule]
        for kind, line in LINES.items():
            chosen = [row["resumed"] for row in of_rule if row["kind"] == kind]
            times = np.sort([ticks * period for ticks in chosen if ticks is not None])
            if not len(times):
                continue
            longest = max(longest, float(times[-1]))
            share = np.arange(1, len(times) + 1) / len(chosen)
            left.step(times, share, where="post", color=colour, ls=line, label=f"{WORDS[rule]}, {kind}")
        both = [(row["foretold"], row["resumed"]) for row in of_rule if None not in (row["foretold"], row["resumed"])]
        if both:
            right.plot(*(np.array(both, float).T * period), ".", ms=3, color=colour, alpha=0.3, label=WORDS[rule])
    left.axvline(RESUME_SECONDS, color=RED, lw=0.8, ls=":")
    left.text(RESUME_SECONDS, 1.03, "allowed", color=RED, fontsize=8, ha="center")
    left.set(xlabel="time from home (s)", ylabel="share of the starts that have resumed", ylim=(0.0, 1.02))
    if left.get_legend_handles_labels()[0]:
        left.legend(fontsize=8, loc="lower right")
    right.plot([0.0, longest], [0.0, longest], color="0.5", lw=0.8)
    right.set(xlabel="T: foretold by the network alone (s)", ylabel="measured in the whole system (s)")
    if right.get_legend_handles_labels()[0]:
        right.legend(fontsize=8, markerscale=3)
    save(figure, path)
