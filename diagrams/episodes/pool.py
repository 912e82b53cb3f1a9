"""Many episodes over worker processes, each of which builds the diagram once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from diagrams.episodes.calibration import Calibration, Controller
from diagrams.episodes.episode import DETECTION_TICKS, Outcome, Until
from diagrams.world.scenario import World
from models.errors import InputError

if TYPE_CHECKING:
    from diagrams.episodes.rollout import Record, Rollout


KEPT = 2  # diagrams a process keeps, each with a renderer


@dataclass(frozen=True)
class Job:
    """One episode to draw and to run."""

    seed: int
    kind: str
    rnn: str = "lstm"
    until: Until = "task"  # what the run ends with
    log: Path | None = None  # .npz for the run's record, see diagrams/episodes/record.py


@dataclass(frozen=True)
class Result:
    """An outcome, and how large the recall's errors were."""

    job: Job
    outcome: Outcome
    squared_error_sum: np.ndarray  # (N + 1) sum of l_n over the ticks without disturbance
    ticks: int
    peak_normal: np.ndarray  # (N + 1) largest l_n before the onset (of the whole run without one)
    peak_disturbed: np.ndarray | None  # (N + 1) largest l_n from the onset to the end of the disturbance + 5 ticks


class Worker:
    """The episodes of one process: what they share is loaded once, and the diagram of each controller built once."""

    def __init__(self, world: World, encoder: Path):
        # The batch-1 network is fastest on one thread, and the processes share the cores. Set before OpenMP starts.
        os.environ["OMP_NUM_THREADS"] = "1"
        import torch

        from diagrams.episodes.sampling import EpisodeSampler
        from models.inference import Encoder

        torch.set_num_threads(1)
        self._world, self._encoder = world, Encoder(encoder)
        self._draws = EpisodeSampler(world)
        self._rollouts: dict[Controller, Rollout] = {}

    def rollout(self, controller: Controller) -> Rollout:
        """The diagram with that controller; raises as diagrams.episodes.calibration.make_detector and Rollout do."""
        from diagrams.episodes.calibration import make_detector
        from diagrams.episodes.rollout import Rollout
        from models.inference import Policy

        if controller not in self._rollouts:
            while len(self._rollouts) >= KEPT:
                del self._rollouts[next(iter(self._rollouts))]  # the oldest: a sweep goes controller by controller
            policy = Policy(controller.policy)
            detector = make_detector(
                controller.detector, policy, controller.policy.parent, calibration=controller.calibration
            )
            self._rollouts[controller] = Rollout(self._world, self._encoder, policy, *detector)
        return self._rollouts[controller]

    def run(self, job: Job, controller: Controller) -> tuple[Outcome, Record]:
        """Draws and runs the episode."""
        episode = self._draws.draw(job.seed, job.kind, rnn=job.rnn, detector=controller.detector)
        outcome, record = self.rollout(controller).run(episode, until=job.until)
        if job.log is not None:
            from diagrams.episodes.record import save_record

            save_record(job.log, record, outcome)
        return outcome, record


def stretches(record: Record) -> tuple[slice, slice]:
    """Ticks before the onset (all without one), and from the onset to the end of the disturbance + 5 ticks (none without one)."""
    active = record.active > 0.5
    onset = int(np.argmax(active)) if active.any() else len(active)
    return slice(0, onset), slice(onset, onset + int(active.sum()) + DETECTION_TICKS)


def digest_errors(job: Job, outcome: Outcome, record: Record) -> Result:
    """What the calibration and the evaluation need of a run."""
    before, after = stretches(record)
    errors, disturbed = record.squared_errors[before], record.squared_errors[after]
    peak = disturbed.max(axis=0) if len(disturbed) else None
    return Result(job, outcome, errors.sum(axis=0), len(errors), errors.max(axis=0), peak)


_worker: Worker | None = None


def _run(
    world: World, encoder: Path, job: Job, controller: Controller, digest: Callable[[Job, Outcome, Record], Any]
) -> Any:
    global _worker
    # With the first job, not by the pool's initializer, whose errors never reach the parent.
    _worker = _worker or Worker(world, encoder)
    return digest(job, *_worker.run(job, controller))


def run_jobs(
    world: World,
    encoder: Path,
    policy: Path,
    jobs: list[Job],
    *,
    workers: int,
    calibration: Calibration | None = None,
    detector: str = "recall",
    digest: Callable[[Job, Outcome, Record], Any] = digest_errors,
) -> Iterator[Any]:
    """Runs `jobs` and yields `digest(job, outcome, record)` of each as it comes; `calibration` replaces the one in the files.

    Raises what the first job that fails raises, WeightsError and InputError among it, and begins no other.
    """
    if workers < 1:
        raise InputError(f"the number of workers {workers} is too small: choose 1 or more")
    controller = Controller(policy, detector, calibration)
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        for future in as_completed([pool.submit(_run, world, encoder, job, controller, digest) for job in jobs]):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)
