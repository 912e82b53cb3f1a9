"""The pictures of figures.py beside Fig. 5 (timeline.py): numbers in, one file out."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.drawing.style import new_figure, save
from diagrams.episodes.switching import GUARD

PICTURES = ("camera", r"decoded $f_k$", r"decoded $f^R_{k+1}$")
PAPER_GAMMA = 3.0


def save_recall_loss(losses: Mapping[str, np.ndarray], path: Path) -> None:
    """Fig. 4; `losses`: by the network's name (training seeds, N) mean squared error, scaled, n = 1..N ticks back."""
    figure, axis = new_figure(figsize=(5.5, 3.6))
    for name, rows in losses.items():
        n, mean = np.arange(1, rows.shape[1] + 1), rows.mean(axis=0)
        axis.plot(n, mean, marker="o", ms=3, label=f"{name.upper()} ({len(rows)} training seed{'s'[: len(rows) > 1]})")
        axis.fill_between(n, rows.min(axis=0), rows.max(axis=0), alpha=0.2, lw=0)
    axis.set(xlabel="ticks back, $n$", ylabel="mean squared recall error (scaled)", ylim=(0, None))
    axis.legend(frameon=False)
    save(figure, path)


def save_reconstructions(columns: Sequence[tuple[float, str, Sequence[np.ndarray]]], path: Path) -> None:
    """Fig. 6; `columns`: (s, what happens, one uint8 picture (112, 112, 3) for each of PICTURES)."""
    size = (1.7 * len(columns), 1.8 * len(PICTURES) + 0.4)
    figure, axes = new_figure(len(PICTURES), len(columns), figsize=size, squeeze=False)
    for column, (seconds, what, pictures) in zip(axes.T, columns, strict=True):
        column[0].set_title(textwrap.fill(what, 24) + f"\n{seconds:.1f} s", fontsize=6)
        for axis, picture in zip(column, pictures, strict=True):
            axis.imshow(picture)
            axis.set(xticks=[], yticks=[])
    for axis, label in zip(axes[:, 0], PICTURES, strict=True):
        axis.set_ylabel(label, fontsize=8)
    save(figure, path)


def save_states(
    runs: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]], origin: np.ndarray, ratios: np.ndarray, path: Path
) -> None:
    """Fig. 7; arguments as of principal_states in diagrams/episodes/figure_numbers.py."""
    size = (9, 4.0 * len(runs))
    figure, axes = new_figure(len(runs), 2, figsize=size, sharex=True, sharey="col", squeeze=False)
    for row, (title, (states, subtask, alpha)) in zip(axes, runs.items(), strict=True):
        returning = alpha >= GUARD
        for axis, (i, j) in zip(row, ((0, 1), (0, 2)), strict=True):
            for label, colour, chosen in (
                ("subtask 1", "tab:blue", (subtask == 1) & ~returning),
                ("subtask 2", "tab:green", (subtask == 2) & ~returning),
                (r"$\alpha \geq 0.5$: on its own predictions", "crimson", returning),
            ):
                line = np.where(chosen[:, None], states, np.nan)  # a gap where another part comes in between
                axis.plot(line[:, i], line[:, j], color=colour, lw=1.0, marker=".", ms=2, label=label)
            axis.plot(*origin[[i, j]], color="black", marker="*", ms=12, ls="", label="switching point")
            x, y = (f"PC{component + 1} ({100 * ratios[component]:.1f} %)" for component in (i, j))
            axis.set(xlabel=x, ylabel=y, title=title)
    axes[0, 0].legend(fontsize=7, frameon=False)
    save(figure, path)


def save_gamma_curve(
    curves: Mapping[str, Sequence[dict[str, Any]]], bounds: Mapping[str, tuple[np.ndarray, np.ndarray]], path: Path
) -> None:
    """Switching success against gamma (the paper's rule); `curves`, `bounds`: see gamma_curves in sweeps/gamma.py."""
    figure, axis = new_figure(figsize=(6.5, 4))
    for n, (label, points) in enumerate(curves.items()):
        low, high = 100 * np.array([p["interval"] for p in points]).T
        gammas = [p["gamma"] for p in points]
        axis.plot(gammas, [100 * p["rate"] for p in points], marker="o", ms=3, color=f"C{n}", label=label)
        axis.fill_between(gammas, low, high, color=f"C{n}", alpha=0.15, lw=0)
        axis.plot(bounds[label][0], 100 * bounds[label][1], color=f"C{n}", lw=0.8, ls=":")
    axis.axvline(PAPER_GAMMA, color="0.5", lw=0.8, ls="--")
    axis.text(PAPER_GAMMA, 1.01, "the paper's 3", fontsize=7, ha="center", transform=axis.get_xaxis_transform())
    axis.plot([], [], color="0.4", lw=0.8, ls=":", label="no false alarm, and noticed\n(from the runs at the largest)")
    axis.set(xlabel=r"$\gamma$", ylabel="switching success (%)", xscale="log", ylim=(-3, 103))
    ticks = sorted({p["gamma"] for points in curves.values() for p in points})
    axis.set_xticks(ticks, [f"{gamma:g}" for gamma in ticks])
    axis.set_xticks([], minor=True)
    axis.legend(fontsize=7, frameon=False)
    save(figure, path)
