"""Runs one episode in a worker: what the episodes of a process share is loaded once, and each diagram is built once."""

from dataclasses import dataclass, replace
from pathlib import Path

from diagrams.episodes.calibration import Controller, make_detector, stored_calibration
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.pool import kept_in_thread
from diagrams.episodes.record import Record
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World
from diagrams.world.faults.registry import is_fault
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES

KEPT = 2  # diagrams a thread keeps, each with a renderer


@dataclass(frozen=True)
class Job:
    """One episode to run: sampled from `seed` under a disturbance of `kind`, or given in full as `episode`."""

    world: World
    encoder: Path
    controller: Controller
    seed: int = 0
    kind: str = "none"
    severity: float = 1.0  # of a fault
    episode: Episode | None = None
    until: Until = "task"  # what the run ends with
    picture_every: int = 0  # see Rollout.run


def build_rollout(world: World, encoder: Path, controller: Controller, **shown):
    """The Rollout with the networks in these files and a detector that is not calibrated yet; `shown`: see Rollout.

    Raises InputError as `make_detector` and `Rollout` do, WeightsError for a file that is missing or damaged.
    """
    from diagrams.episodes.rollout import Rollout
    from models.inference import Encoder
    from models.policy import NoFeatures

    policy = controller.load()
    if hasattr(policy, "encode"):
        images = policy
    elif getattr(policy, "looks", False):
        images = NoFeatures()
    else:
        images = kept_in_thread(("encoder", encoder), lambda: Encoder(encoder))
    detector = make_detector(controller.detector, policy, controller.policy.parent)
    return Rollout(world, images, policy, detector, recovery=controller.recovery, **shown)


def run_episode(job: Job) -> tuple[Outcome, Record]:
    """Runs the episode of `job`; raises InputError as `make_detector`, `EpisodeSampler` and `Rollout` do."""
    rollout, episode, calibration = prepared(job)
    return rollout.run(episode, until=job.until, picture_every=job.picture_every, calibration=calibration)


def run_branched(job: Job) -> tuple[Outcome, Record, int]:
    """As `run_episode`, and the ticks that were saved, because the scene is one of the last ones: see branching.py."""
    from diagrams.episodes.branching import Branches

    rollout, episode, calibration = prepared(job)
    key = ("branches", repr(job.world), job.encoder, job.controller, rollout.fault and rollout.fault.kind)
    branches = kept_in_thread(key, lambda: Branches(rollout))
    return branches.run(episode, until=job.until, calibration=calibration)


def prepared(job: Job):
    """The rollout of this thread, the episode of `job` and the calibration."""
    from diagrams.episodes.sampling import EpisodeSampler

    controller, world = job.controller, repr(job.world)
    kind = job.kind if job.episode is None else job.episode.disturbance.kind
    fault = kind if is_fault(kind) else None
    own = controller.detector, controller.spec, controller.recovery
    parts = ("rollout", world, job.encoder, controller.policy, *own, fault)
    rollout = kept_in_thread(parts, lambda: build_rollout(job.world, job.encoder, controller, fault=fault), KEPT)
    episode = job.episode
    if episode is None:
        sampler = kept_in_thread(("sampler", world), lambda: EpisodeSampler(job.world))
        detector = DETECTORS.label(controller.detector)
        names = dict(rnn=rollout.policy.name, detector=detector)
        episode = sampler.sample(job.seed, job.kind, **names, severity=job.severity)
        episode = replace(episode, recovery=RECOVERIES.label(controller.recovery))
    calibration = controller.calibration or kept_in_thread(
        ("calibration", controller),
        lambda: stored_calibration(controller.detector, rollout.policy, controller.policy.parent),
    )
    return rollout, episode, calibration
