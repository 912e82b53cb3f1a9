"""The timeline of a run, as the paper's Fig. 5: posture, both controllers' steps and alpha over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD
from diagrams.world.names import ARM_JOINTS

FORMATS = (".png", ".svg", ".pdf")
LABELLED = ("disturb", "switched", "initial posture", "resumes", "picked", "placed", "taken")


def save_timeline(record: Record, path: Path, title: str) -> None:
    """Writes the picture of `record` to `path` (see FORMATS)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = record.time
    figure, axes = plt.subplots(
        5, 1, figsize=(11, 9), sharex=True, height_ratios=(3, 1.6, 1.6, 1.4, 1.4), layout="constrained"
    )
    colours = plt.get_cmap("tab10")
    for rows, axis, label in (
        (record.posture, axes[0], "m (deg)"),
        (record.rnn_step, axes[1], r"$\Delta m^R$ (deg)"),
        (record.regulator_step, axes[2], r"$\Delta m^L$ (deg)"),
    ):
        for j in range(ARM_JOINTS):
            axis.plot(t, np.rad2deg(rows[:, j]), color=colours(j), lw=1.2, label=f"joint {j + 1}")
        axis.set_ylabel(label)
    fingers = axes[0].twinx()
    fingers.plot(t, 1000 * record.posture[:, -1], color="0.4", lw=1.0, ls=":", label="fingers")
    fingers.set_ylabel("fingers (mm)")
    fingers.set_ylim(0, 200)
    axes[0].legend(ncol=7, fontsize=7, loc="lower center", frameon=False)
    axes[3].semilogy(t, np.maximum(record.errors.max(axis=1), 1e-3), color="0.2", lw=1.0)
    axes[3].set_ylabel(r"max $l_n / r_n$")
    axes[4].plot(t, record.alpha, color="crimson", lw=1.4)
    axes[4].axhline(GUARD, color="0.6", lw=0.6, ls="--")
    axes[4].set_ylim(-0.05, 1.05)
    axes[4].set_ylabel(r"$\alpha$")
    axes[4].set_xlabel("time (s)")
    for axis in axes:
        axis.set_xlim(t[0], t[-1])
        axis.fill_between(
            t, 0, 1, where=record.active > 0.5, color="orange", alpha=0.35, lw=0, transform=axis.get_xaxis_transform()
        )
        axis.fill_between(
            t,
            0,
            1,
            where=record.alpha >= GUARD,
            color="crimson",
            alpha=0.08,
            lw=0,
            transform=axis.get_xaxis_transform(),
        )
        for seconds, what in record.events:
            if any(word in what for word in LABELLED):
                axis.axvline(seconds, color="0.7", lw=0.6)
    # Labels of events that lie close together take turns in height.
    height, last = 0, -np.inf
    for seconds, what in record.events:
        if any(word in what for word in LABELLED):
            height = (height + 1) % 4 if seconds - last < 0.25 * t[-1] else 0
            last = seconds
            axes[0].text(
                seconds,
                1.02 + 0.07 * height,
                what,
                fontsize=7,
                transform=axes[0].get_xaxis_transform(),
                ha="left",
                va="bottom",
            )
    figure.suptitle(title, fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
