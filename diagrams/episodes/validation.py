"""Validation episodes: what networks are chosen by and detectors calibrated on. Their seeds are no evaluation's seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Outcome
from diagrams.episodes.pool import Pool
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import episode_seeds
from diagrams.episodes.switching import Until
from diagrams.episodes.thresholds import ErrorPeaks
from diagrams.world.configuration import World
from systems.detectors import DETECTORS

R = TypeVar("R")


@dataclass(frozen=True)
class Validation:
    """Runs the validation episodes of one `seed` (0 to 99) over `pool`."""

    pool: Pool
    world: World
    encoder: Path
    seed: int

    def seeds(self, count: int) -> list[int]:
        """Of its first so many episodes."""
        return episode_seeds("validation", self.seed, count)

    def run(
        self, controller: Controller, reduce: Callable[[Job], R], counts: Mapping[str, int], until: Mapping[str, Until]
    ) -> dict[str, list[R]]:
        """So many episodes of each kind of disturbance; `reduce` of each, by kind, in the order of their seeds.

        `reduce` runs in a worker: a function of a module. `until`: what the runs of a kind end with. Raises InputError as
        `run_episode` does.
        """
        from tqdm import tqdm

        seeds = self.seeds(max(counts.values()))
        jobs = [
            Job(self.world, self.encoder, controller, seed, kind, until=until[kind])
            for kind, count in counts.items()
            for seed in seeds[:count]
        ]
        words = f"{controller.policy.stem} {DETECTORS.label(controller.detector)} {', '.join(counts)}"
        done = self.pool.run(reduce, jobs)
        bar = tqdm(done, total=len(jobs), desc=words, unit="episode", leave=False, disable=None)
        found = {(job.kind, job.seed): reduced for job, reduced in bar}
        return {kind: [found[kind, seed] for seed in seeds[:count]] for kind, count in counts.items()}


def outcome_of(job: Job) -> Outcome:
    """The outcome alone."""
    return run_episode(job)[0]


def error_peaks_of(job: Job) -> ErrorPeaks:
    """Of the detector's errors; raw ones where its references are 1."""
    outcome, record = run_episode(job)
    return ErrorPeaks.of(outcome, record, record.errors)


def recall_peaks_of(job: Job) -> ErrorPeaks:
    """Of the recall's errors l_n, whatever their references are."""
    outcome, record = run_episode(job)
    return ErrorPeaks.of(outcome, record, record.squared_errors)


def tally(words: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """How these went, as plain types; prints it after `words`."""
    failures = {f"seed {o.seed}": o.failure for o in outcomes if o.failure}
    successes, seconds = sum(bool(o.success) for o in outcomes), float(np.mean([o.sim_seconds for o in outcomes]))
    print(
        f"{words}: {successes} of {len(outcomes)} tasks done, {seconds:.1f} s on average; failures: {failures or 'none'}",
        flush=True,
    )
    return {
        "successes": successes,
        "switching": sum(o.switch_success for o in outcomes),
        "episodes": len(outcomes),
        "mean_seconds": seconds,
        "failures": failures,
    }
