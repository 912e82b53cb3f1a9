"""Runs one episode in a worker: what the episodes of a process share is loaded once, and each diagram is built once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from diagrams.episodes.calibration import Controller, make_detector
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.pool import kept_in_thread
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World

if TYPE_CHECKING:
    from diagrams.episodes.record import Record
    from diagrams.episodes.rollout import Rollout

KEPT = 2  # diagrams a thread keeps, each with a renderer


@dataclass(frozen=True)
class Job:
    """One episode to run: sampled from `seed` under a disturbance of `kind`, or given in full as `episode`."""

    world: World
    encoder: Path
    controller: Controller
    seed: int = 0
    kind: str = "none"
    episode: Episode | None = None
    until: Until = "task"  # what the run ends with
    pictures: bool = False


def run_episode(job: Job) -> tuple[Outcome, Record]:
    """Runs the episode of `job`; raises InputError as `make_detector`, `EpisodeSampler` and `Rollout` do."""
    episode = job.episode
    if episode is None:
        from diagrams.episodes.sampling import EpisodeSampler

        sampler = kept_in_thread(("sampler", repr(job.world)), lambda: EpisodeSampler(job.world))
        rollout = rollout_for(job)
        episode = sampler.sample(job.seed, job.kind, rnn=rollout.policy.name, detector=job.controller.detector_label)
    return rollout_for(job).run(episode, until=job.until, pictures=job.pictures)


def rollout_for(job: Job) -> Rollout:
    """The diagram of the job's world and controller, built once in this thread."""
    import torch

    from diagrams.episodes.rollout import Rollout
    from models.inference import Encoder, Policy

    def build() -> Rollout:
        torch.set_num_threads(1)  # fastest at batch 1, and the sums of every evaluation
        encoder = kept_in_thread(("encoder", job.encoder), lambda: Encoder(job.encoder))
        policy = Policy(job.controller.policy)
        detector = make_detector(
            job.controller.detector, policy, job.controller.policy.parent, calibration=job.controller.calibration
        )
        return Rollout(job.world, encoder, policy, *detector)

    return kept_in_thread(("rollout", repr(job.world), job.encoder, job.controller), build, most=KEPT)
