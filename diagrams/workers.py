"""Many episodes over worker processes, each of which builds the diagram once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagrams.episode import DETECTION_TICKS, Outcome
from diagrams.scenario import World


@dataclass(frozen=True)
class Calibration:
    """What the recall detector needs beside the network (Eqs. 5, 6): mean errors (N + 1), beta, gamma; dimensionless."""

    mean_errors: tuple[float, ...]
    beta: float
    gamma: float


@dataclass(frozen=True)
class Job:
    """One episode to draw and to run."""

    seed: int
    kind: str
    rnn: str = "lstm"
    detection_only: bool = False  # ends as soon as the disturbance cannot be detected any more


@dataclass(frozen=True)
class Result:
    """An outcome, and how large the recall's errors were."""

    job: Job
    outcome: Outcome
    squared_error_sum: np.ndarray  # (N + 1) sum of l_n over the ticks without disturbance
    ticks: int
    peak_normal: np.ndarray  # (N + 1) largest l_n before the onset (of the whole run without one)
    peak_disturbed: np.ndarray | None  # (N + 1) largest l_n from the onset to the end of the disturbance + 5 ticks


_worker = None


class _Worker:
    def __init__(self, world: World, encoder: Path, policy: Path, calibration: Calibration | None):
        # The batch-1 network is fastest on one thread, and the processes share the cores. Set before OpenMP starts.
        os.environ["OMP_NUM_THREADS"] = "1"
        import torch

        from diagrams.draws import EpisodeDraws
        from diagrams.rollout import COMPONENT_WEIGHTS, Rollout
        from models.inference import Encoder, Policy
        from systems.detector import RecallDetector

        torch.set_num_threads(1)
        network = Policy(policy)
        detector = None
        if calibration is not None:
            detector = RecallDetector(
                posture_size=network.posture_size,
                horizon=network.horizon,
                state_size=network.state_size,
                mean_errors=np.array(calibration.mean_errors),
                beta=calibration.beta,
                gamma=calibration.gamma,
                component_weights=COMPONENT_WEIGHTS,
            )
        self.draws = EpisodeDraws(world)
        self.rollout = Rollout(world, Encoder(encoder), network, detector)

    def run(self, job: Job) -> Result:
        outcome, record = self.rollout.run(
            self.draws.draw(job.seed, job.kind, rnn=job.rnn),
            ticks_after=DETECTION_TICKS if job.detection_only else None,
        )
        active = record.active > 0.5
        onset = int(np.argmax(active)) if active.any() else len(active)
        errors = record.squared_errors
        disturbed = errors[onset : onset + int(active.sum()) + DETECTION_TICKS]
        return Result(
            job,
            outcome,
            errors[:onset].sum(axis=0),
            onset,
            errors[:onset].max(axis=0),
            disturbed.max(axis=0) if len(disturbed) else None,
        )


def _start(*arguments) -> None:
    global _worker
    _worker = _Worker(*arguments)


def _run(job: Job) -> Result:
    assert _worker is not None
    return _worker.run(job)


def run_jobs(
    world: World, encoder: Path, policy: Path, jobs: list[Job], *, workers: int, calibration: Calibration | None = None
) -> Iterator[Result]:
    """Runs `jobs` and yields each result as it comes; `calibration` replaces the one in the policy's file."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        workers, mp_context=spawn, initializer=_start, initargs=(world, encoder, policy, calibration)
    ) as pool:
        for future in as_completed([pool.submit(_run, job) for job in jobs]):
            yield future.result()
