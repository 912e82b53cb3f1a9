"""The certificate of mode `return`: V over time, and where in the box the arm is when it is needed."""

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save

COLOURS = {"box": BLUE, "onsets": GREEN, "targets": ORANGE}
WORDS = {"box": "uniform in the box", "onsets": "onsets of a disturbance", "targets": "targets of disturbance A"}
BINS, LEAST = 40, 1e-3  # of V in the picture


def save_certificate(data: dict[str, Any], path: Path) -> None:
    """Draws V against the certified rates, of the box (left), of onsets and targets (middle); and V where they start.

    Args:
        data: by kind of COLOURS `values`, V at the ticks of each clear way home, `promises`, V at most at the ticks,
            and `levels`, (n,) V of the postures; `at_home`, the level within which the arm is at home; `period`, s.
    """
    figure, (left, middle, right) = new_figure(1, 3, figsize=(15, 4.6))
    parts = (left, ("box",), "the whole box"), (middle, ("onsets", "targets"), "onsets and targets")
    for axis, kinds, title in parts:
        _draw_values(axis, data, kinds)
        axis.set_title(f"clear ways home, {title}", fontsize=10)
    bins = np.linspace(0.0, max(1.0, *(np.max(v, initial=0.0) for v in data["levels"].values())), BINS + 1)
    for kind, levels in data["levels"].items():
        weights = np.full(len(levels), 1.0 / max(len(levels), 1))
        label = f"{WORDS[kind]} ({len(levels)})"
        right.hist(levels, bins, weights=weights, histtype="step", lw=1.5, color=COLOURS[kind], label=label)
    right.axvline(1.0, color="0.4", ls=":")
    right.text(0.99, 0.8, "border of the box", rotation=90, ha="right", va="center", fontsize=8, color="0.4",
               transform=right.get_xaxis_transform())  # fmt: skip
    right.set(xlabel="V", ylabel="share of the postures")
    right.margins(y=0.4)  # room for the words
    right.legend(fontsize=8, loc="upper center")
    right.set_title("where in the box the arm is", fontsize=10)
    save(figure, path)


def _draw_values(axis: Any, data: dict[str, Any], kinds: tuple[str, ...]) -> None:
    longest = 0
    for kind in kinds:
        values = data["values"][kind]
        if not values:
            continue
        length = max(len(v) for v in values)
        longest = max(longest, length)
        rows = np.array([np.append(v, np.full(length - len(v), v[-1])) for v in values])  # at home it stays there
        time = data["period"] * np.arange(length)
        low, median, high = np.maximum(np.quantile(rows, [0.0, 0.5, 1.0], axis=0), LEAST)
        axis.fill_between(time, low, high, color=COLOURS[kind], alpha=0.2, lw=0)
        axis.semilogy(time, median, color=COLOURS[kind], label=f"{WORDS[kind]}: median and range of {len(rows)}")
    promise = data["promises"][kinds[0]]
    home = data["at_home"]
    shown = min(len(promise), max(longest, int(np.argmax(promise <= home)) + 3))
    time = data["period"] * np.arange(shown)
    axis.semilogy(time, promise[:shown], color=RED, ls="--", label="certified")
    axis.axhline(home, color="0.5", lw=0.8, ls=":")
    axis.text(time[-1], 0.9 * home, "surely at home", ha="right", va="top", fontsize=8, color="0.4")
    axis.set(ylim=(LEAST, 1.5), xlabel="time (s)", ylabel="V")
    axis.legend(fontsize=8, loc="upper right")
