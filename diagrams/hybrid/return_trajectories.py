"""Trajectories home from many postures, over worker processes; one broken off goes on where it was."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.store import RowStore
from diagrams.hybrid.lyapunov import Lyapunov
from diagrams.hybrid.return_loop import ReturnLoop
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, SPOTS
from diagrams.world.task import at_home

CHUNK = 25  # postures a job, and a row of the store


@dataclass(frozen=True)
class Sample:
    """A posture at rest in a scene, from which the arm is brought home."""

    joints: np.ndarray  # (7,) rad
    can_xy: np.ndarray  # (2,) m, world
    vacant: str


@dataclass(frozen=True)
class Trajectory:
    """What came of a sample."""

    rows: np.ndarray  # (n, 7) joint angles at the ticks, rad
    touches: str | None  # the model that the straight path home touches (nearer than 1 cm)
    broke_off: str | None = None  # why the simulation broke off

    def arrival(self, home: np.ndarray) -> int:
        """First tick at which every joint is at `home` (7, rad); -1 without one, or where the simulation broke off."""
        there = at_home(self.rows, home)
        return int(np.argmax(there)) if there.any() and self.broke_off is None else -1


def sample_postures(
    world: World,
    lyapunov: Lyapunov,
    level: float,
    count: int,
    rng: np.random.Generator,
    outside: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Sample]:
    """`count` samples inside the level set, or (uniform within the limits `outside`, (7,) each, rad) outside of it.

    A posture in which the arm is inside the desk, the shelf or a can is none: it is sampled again.
    """
    from tqdm import tqdm

    checker, home = CollisionChecker(gap=0.0), world.initial_posture[:ARM_JOINTS]
    corner, opposite = world.grid.bounds
    samples: list[Sample] = []
    title = f"sample {'inside' if outside is None else 'outside'}"
    with tqdm(total=count, desc=title, leave=False, disable=None) as bar:
        while len(samples) < count:
            if outside is None:
                joints = home + lyapunov.sample_inside(rng, level, 1)[0]
            else:
                joints = rng.uniform(*outside)
                if lyapunov.value(joints - home) <= level:
                    continue
            sample = Sample(joints, rng.uniform(corner, opposite), str(rng.choice(SPOTS)))
            checker.set_scene(sample.can_xy, sample.vacant)
            if checker.first_touch(joints) is None:
                samples.append(sample)
                bar.update()
    return samples


@dataclass(frozen=True)
class Job:
    """The samples of one row of the store."""

    world: World
    samples: Sequence[Sample]

    @property
    def key(self) -> str:
        """Of the row: a hash of the samples."""
        total = hashlib.sha256()
        for sample in self.samples:
            total.update(sample.joints.tobytes() + sample.can_xy.tobytes() + sample.vacant.encode())
        return total.hexdigest()[:24]


def run_job(job: Job) -> list[Trajectory]:
    """The trajectory of each sample; the diagram is built once in a process."""
    loop = kept_in_thread(("return loop", repr(job.world)), lambda: ReturnLoop(job.world))
    checker = kept_in_thread("checker", CollisionChecker)
    home, found = job.world.initial_posture[:ARM_JOINTS], []
    for sample in job.samples:
        checker.set_scene(sample.can_xy, sample.vacant)
        touches = checker.path_touches(sample.joints, home)
        rows, broke_off = loop.run(sample.joints, sample.can_xy, sample.vacant)
        found.append(Trajectory(rows, touches, broke_off))
    return found


def trajectories_home(world: World, samples: list[Sample], pool: Pool, store: RowStore, title: str) -> list[Trajectory]:
    """The trajectory of each sample, in their order; what is in the store is not run again; `title`: of the bar."""
    from tqdm import tqdm

    jobs = [Job(world, samples[i : i + CHUNK]) for i in range(0, len(samples), CHUNK)]
    missing = [job for job in jobs if job.key not in store.rows]
    known = len(samples) - sum(len(job.samples) for job in missing)
    with tqdm(total=len(samples), initial=known, desc=title, unit="posture", disable=None) as bar:
        for job, found in pool.run(run_job, missing):
            store.add(job.key, [[t.rows.tolist(), t.touches, t.broke_off] for t in found])
            bar.update(len(found))
    return [Trajectory(np.array(rows), *words) for job in jobs for rows, *words in store.rows[job.key]]
