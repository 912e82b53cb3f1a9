"""Trajectories home from many postures, over worker processes; one broken off goes on where it was."""

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


@dataclass(frozen=True)
class Sample:
    """A posture at rest in a scene, from which the arm is brought home."""

    joints: np.ndarray  # (7,) rad
    can_xy: np.ndarray  # (2,) m, world
    vacant: str

    @property
    def key(self) -> str:
        """Of its row in the store."""
        return f"{self.joints.tolist()} {self.can_xy.tolist()} {self.vacant}"


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


def run_job(job: tuple[World, Sample]) -> Trajectory:
    """The trajectory of a sample; the diagram is built once in a process."""
    world, sample = job
    loop = kept_in_thread(("return loop", repr(world)), lambda: ReturnLoop(world))
    checker = kept_in_thread("checker", CollisionChecker)
    checker.set_scene(sample.can_xy, sample.vacant)
    touches = checker.path_touches(sample.joints, world.initial_posture[:ARM_JOINTS])
    rows, broke_off = loop.run(sample.joints, sample.can_xy, sample.vacant)
    return Trajectory(rows, touches, broke_off)


def trajectories_home(world: World, samples: list[Sample], pool: Pool, store: RowStore, title: str) -> list[Trajectory]:
    """The trajectory of each sample, in their order; what is in the store is not run again; `title`: of the bar."""
    from tqdm import tqdm

    missing = [(world, sample) for sample in samples if sample.key not in store.rows]
    known = len(samples) - len(missing)
    with tqdm(total=len(samples), initial=known, desc=title, unit="posture", disable=None) as bar:
        for (_, sample), found in pool.run(run_job, missing):
            store.add(sample.key, [found.rows.tolist(), found.touches, found.broke_off])
            bar.update()
    return [Trajectory(np.array(rows), *words) for rows, *words in (store.rows[sample.key] for sample in samples)]
