"""A run over time, as in the paper's Fig. 5: posture, both controllers' steps and alpha."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from diagrams.drawing.style import Axes, Figure, new_figure, save
from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD
from diagrams.world.names import ARM_JOINTS

LABELLED = ("disturb", "switched", "initial posture", "resumes", "picked", "placed", "elsewhere")


def save_timeline(record: Record, path: Path, title: str) -> None:
    """Writes the picture of one run to `path`, see PLOT_FORMATS: with fingers, the detector's errors and the events."""
    figure, axes = new_figure(5, 1, figsize=(11, 9), sharex=True, height_ratios=(3, 1.6, 1.6, 1.4, 1.4))
    _draw_signals([*axes[:3], axes[4]], record)
    fingers = axes[0].twinx()
    fingers.plot(record.time, 1000 * record.posture[:, -1], color="0.4", lw=1.0, ls=":", label="fingers")
    fingers.set(ylabel="fingers (mm)", ylim=(0, 200))
    axes[3].semilogy(record.time, np.maximum(record.errors.max(axis=1), 1e-3), color="0.2", lw=1.0)
    axes[3].set_ylabel(r"max $l_n / \overline{l}_n$")
    _shade(axes[3], record)
    axes[4].set(xlim=(record.time[0], record.time[-1]), xlabel="time (s)")
    # Labels of events that lie close together take turns in height.
    height, last = 0, -np.inf
    for seconds, what in record.events:
        if any(word in what for word in LABELLED):
            height = (height + 1) % 4 if seconds - last < 0.25 * record.time[-1] else 0
            last = seconds
            over = axes[0].get_xaxis_transform()
            axes[0].text(seconds, 1.02 + 0.07 * height, what, fontsize=7, transform=over, va="bottom")
            for axis in axes:
                axis.axvline(seconds, color="0.7", lw=0.6)
    figure.suptitle(title, fontsize=10)
    _label_joints(figure, axes[0])
    save(figure, path)


def save_sequences(records: Mapping[str, Record], path: Path) -> None:
    """Fig. 5; `records`: one run for each title, a column each."""
    size, heights = (4.6 * len(records), 7.5), (2.2, 1.3, 1.3, 1)
    shared = {"sharex": "col", "sharey": "row", "squeeze": False}
    figure, axes = new_figure(4, len(records), figsize=size, height_ratios=heights, **shared)
    for column, (title, record) in zip(axes.T, records.items(), strict=True):
        _draw_signals(column, record)
        column[0].set_title(title, fontsize=10)
        column[3].set_xlabel("time (s)")
    for axis in axes.flat:
        axis.label_outer()
    _label_joints(figure, axes[0, 0])
    save(figure, path)


def _draw_signals(axes: Sequence[Axes], record: Record) -> None:
    """On four axes the posture, the network's steps, the LQR's, and alpha."""
    labels = r"$m$ (deg)", r"$\Delta m^R$ (deg)", r"$\Delta m^L$ (deg)"
    for axis, rows, label in zip(axes, (record.posture, record.rnn_step, record.regulator_step), labels, strict=False):
        for joint in range(ARM_JOINTS):
            axis.plot(record.time, np.rad2deg(rows[:, joint]), lw=1.1, label=f"joint {joint + 1}")
        axis.set_ylabel(label)
    axes[3].plot(record.time, record.alpha, color="crimson", lw=1.3)
    axes[3].axhline(GUARD, color="0.6", lw=0.6, ls="--")
    axes[3].set(ylim=(-0.05, 1.05), ylabel=r"$\alpha$")
    for axis in axes:
        _shade(axis, record)


def _label_joints(figure: Figure, axis: Axes) -> None:
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncol=7, fontsize=7, frameon=False)


def _shade(axis: Axes, record: Record) -> None:
    """Orange where the arm is disturbed, red where the LQR has it."""
    for where, colour, alpha in ((record.active > 0.5, "orange", 0.35), (record.alpha >= GUARD, "crimson", 0.08)):
        over = axis.get_xaxis_transform()
        axis.fill_between(record.time, 0, 1, where=where, color=colour, alpha=alpha, lw=0, transform=over)
