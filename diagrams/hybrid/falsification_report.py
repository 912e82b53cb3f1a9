"""What a search for defeats found: the report, and its picture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from diagrams.episodes.episode import Episode
from diagrams.hybrid.falsification import Trial
from diagrams.hybrid.perturbations import DEFEATS, FORMS


def report(found: dict[str, list[Trial]], files: dict[tuple[str, int], str], scenes: list[Episode]) -> dict:
    """Plain types: counterexamples, smallest first; what each sampler reached. `files`: name of the scenario file by sampler and trial."""
    counterexamples = [
        {
            "file": files[name, n],
            "sampler": name,
            "trial": n + 1,
            "failure": trial.failure,
            "size_deg": trial.moved_deg,
            "form": trial.push.form,
            "length_ticks": trial.push.ticks,
            "magnitude": trial.push.magnitude,
            "scene": scenes[trial.push.scene].seed,
            "subtask": trial.push.subtask,
            "level_m": trial.push.level,
            "digest": trial.digest,
        }
        for name, trials in found.items()
        for n, trial in enumerate(trials)
        if trial.failure is not None
    ]
    counterexamples.sort(key=lambda c: (c["magnitude"], c["file"]))

    def first(trials: list[Trial]) -> int | None:
        return next((n for n, trial in enumerate(trials, start=1) if trial.failure is not None), None)

    return {
        "scenes": [
            {"seed": scene.seed, "can_xy": list(scene.can_xy), "vacant": scene.vacant, "rnn": scene.rnn}
            for scene in scenes
        ],
        "trials": {name: len(trials) for name, trials in found.items()},
        "trials_to_first": {name: first(trials) for name, trials in found.items()},
        "smallest_magnitude": {
            name: min((t.push.magnitude for t in trials if t.failure), default=None) for name, trials in found.items()
        },
        "failures": {
            name: {kind: sum(t.failure == kind for t in trials) for kind in DEFEATS} for name, trials in found.items()
        },
        "forms": {
            name: {form: sum(t.push.form == form for t in trials) for form in FORMS} for name, trials in found.items()
        },
        "undetected_but_done": {
            name: sum(t.switch_failure == "not detected" and t.task_done for t in trials)
            for name, trials in found.items()
        },
        "counterexamples": counterexamples,
        "all_trials": {name: [_plain(trial) for trial in trials] for name, trials in found.items()},
    }


def _plain(trial: Trial) -> dict:
    return asdict(trial) | {"magnitude": trial.push.magnitude}


def save_search(found: dict[str, list[Trial]], path: Path) -> None:
    """The best objective so far over the trials of each sampler (below 1: a counterexample's magnitude), and all trials by size and length."""
    from diagrams.drawing.style import BLUE, GREEN, ORANGE, RED, new_figure, save

    figure, (left, right) = new_figure(1, 2, figsize=(12, 4.6))
    for (name, trials), colour in zip(found.items(), (BLUE, RED, GREEN), strict=False):
        best = np.fmin.accumulate([t.objective for t in trials] or [np.nan])
        left.step(np.arange(1, len(best) + 1), best, where="post", color=colour, label=name)
    left.set_xlim(0, max(map(len, found.values()), default=0) + 1)
    left.set_xlabel("trials")
    left.axhline(1.0, color="0.5", lw=0.8, ls="--")
    left.text(0.5, 0.98, "below: magnitude of a counterexample", fontsize=8, va="top")
    left.text(0.5, 1.02, "above: 1 + margin to one", fontsize=8, va="bottom")
    left.set_ylabel("best objective so far")
    left.set_ylim(0, 2)
    left.legend()
    marks = {None: (".", "0.6"), "not detected": ("o", ORANGE), "not returned": ("s", RED), "not resumed": ("^", BLUE)}
    everything = [trial for trials in found.values() for trial in trials]
    for kind, (mark, colour) in marks.items():
        chosen = [t for t in everything if t.failure == kind]
        right.plot(
            [t.moved_deg for t in chosen], [t.push.ticks for t in chosen], mark, color=colour, ls="",
            label=f"{kind or 'withstood'} ({len(chosen)})",
        )  # fmt: skip
    right.set_xlabel("size (deg, norm over the joints)")
    right.set_ylabel("length (ticks)")
    right.legend(fontsize=8)
    save(figure, path)
