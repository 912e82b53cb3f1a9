"""Validation episodes, on which networks are chosen and detectors calibrated. Their seeds are no evaluation's."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Outcome
from diagrams.episodes.pool import Pool
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.episodes.switching import Until
from diagrams.episodes.thresholds import ValidationRun
from diagrams.world.configuration import World
from models.files.container import file_hash
from systems.detectors import DETECTORS


@dataclass(frozen=True)
class Validation:
    """Runs the validation episodes of one `seed` (0 to 99) over `pool`, those that are not in `store` yet."""

    pool: Pool
    world: World
    encoder: Path
    seed: int
    store: RowStore | None = None  # of this world and encoder, and of detectors that learned nothing

    def run(
        self, controller: Controller, counts: Mapping[str, int], until: Until | None = None
    ) -> dict[str, list[ValidationRun]]:
        """So many episodes of each kind of disturbance, by kind, in the order of their seeds.

        `until`: what they end with; None, for a detector that is off: the task, or the detection where it is disturbed.
        Raises InputError as `run_episode` does.
        """
        from tqdm import tqdm

        seeds = episode_seeds("validation", self.seed, max(counts.values()))
        ends = {kind: until or ("task" if kind == "none" else "detection") for kind in counts}
        jobs = [
            Job(self.world, self.encoder, controller, seed, kind, until=ends[kind])
            for kind, count in counts.items()
            for seed in seeds[:count]
        ]
        known = _hash_of(controller) if self.store else "", repr(controller.calibration)
        which = f"{controller.detector}-{hashlib.sha256(repr(known).encode()).hexdigest()[:16]}"

        def key(job: Job) -> str:
            return f"{job.kind}-{job.seed}-{job.until}-{which}"

        found = {
            (job.kind, job.seed): self.store.read(key(job), ValidationRun.of_row)
            for job in jobs
            if self.store and key(job) in self.store.rows
        }
        words = f"{controller.policy.stem} {DETECTORS.label(controller.detector)} {', '.join(counts)}"
        done = self.pool.run(run_validation, [job for job in jobs if (job.kind, job.seed) not in found])
        with tqdm(total=len(jobs), initial=len(found), desc=words, unit="episode", leave=False, disable=None) as bar:
            for job, run in done:
                if self.store is not None:
                    self.store.add(key(job), run.row())
                found[job.kind, job.seed] = run
                bar.update()
        return {kind: [found[kind, seed] for seed in seeds[:count]] for kind, count in counts.items()}


def _hash_of(controller: Controller) -> str:
    """Of the policy; without loading a file."""
    return file_hash(controller.policy) if controller.spec is None else controller.load().hash


def run_validation(job: Job) -> ValidationRun:
    """Runs one in a worker; its errors are raw, l_n, where the detector's references are 1."""
    return ValidationRun.of(*run_episode(job))


def tally(words: str, runs: Sequence[ValidationRun]) -> dict[str, Any]:
    """How the tasks went, as plain types; prints it after `words`."""
    outcomes: list[Outcome] = [run.outcome for run in runs]
    found = {
        "successes": sum(bool(o.success) for o in outcomes),
        "switching": sum(bool(o.switch_success) for o in outcomes),
        "episodes": len(outcomes),
        "mean_seconds": float(np.mean([o.sim_seconds for o in outcomes])),
        "failures": {f"seed {o.seed}": o.failure for o in outcomes if o.failure},
    }
    done = f"{found['successes']} of {len(outcomes)} tasks done, {found['mean_seconds']:.1f} s on average"
    print(f"{words}: {done}; failures: {found['failures'] or 'none'}", flush=True)
    return found
