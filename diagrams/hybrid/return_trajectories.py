"""Trajectories home from many postures, over worker processes; one broken off goes on where it was."""

from dataclasses import dataclass

import numpy as np

from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.store import RowStore
from diagrams.hybrid.return_loop import ReturnLoop
from diagrams.hybrid.return_samples import Sample
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import CAN_HALF_HEIGHT
from diagrams.world.task import at_home

DROPPED = CAN_HALF_HEIGHT  # m: a can that slipped by more is not in the hand any longer


@dataclass(frozen=True)
class Trajectory:
    """What came of a sample."""

    rows: np.ndarray  # (n, 7) joint angles at the ticks, rad
    nearest: float  # m: smallest distance of arm and held can to anything on that way; 0.01 where it is larger
    touches: str | None  # to which model, if it is nearer than 0.01
    slip: float | None = None  # of the held can in the hand, m; None: there is none
    broke_off: str | None = None  # why the simulation broke off

    def arrival(self, home: np.ndarray) -> int:
        """First tick at which every joint is at `home` (7, rad); -1 without one, or where the simulation broke off."""
        there = at_home(self.rows, home)
        return int(np.argmax(there)) if there.any() and self.broke_off is None else -1

    @property
    def clear(self) -> bool:
        """Whether the way is known to its end, and came near to nothing."""
        return self.touches is None and self.broke_off is None

    @property
    def dropped(self) -> bool:
        """Whether the can is not in the hand any longer."""
        return self.slip is not None and self.slip > DROPPED


def run_job(job: tuple[World, Sample]) -> Trajectory:
    """The trajectory of a sample; the diagram is built once in a process."""
    world, sample = job
    loop = kept_in_thread(("return loop", repr(world)), lambda: ReturnLoop(world))
    checker = kept_in_thread("checker of ways home", lambda: CollisionChecker(rigid_grasp=True))
    can_xy = np.array(sample.can_xy)
    rows, slip, broke_off = loop.run(np.array(sample.joints), can_xy, sample.vacant, sample.held)
    checker.set_scene(None if sample.held else can_xy, sample.vacant, world.opening)
    return Trajectory(rows, *checker.nearest_on(rows), slip, broke_off)


def trajectories_home(world: World, samples: list[Sample], pool: Pool, store: RowStore, title: str) -> list[Trajectory]:
    """The trajectory of each sample, in their order; what is in the store is not run again; `title`: of the bar."""
    from tqdm import tqdm

    missing = [(world, sample) for sample in samples if sample.key not in store.rows]
    known = len(samples) - len(missing)
    with tqdm(total=len(samples), initial=known, desc=title, unit="posture", disable=None) as bar:
        for (_, sample), found in pool.run(run_job, missing):
            store.add(sample.key, [found.rows.tolist(), found.nearest, found.touches, found.slip, found.broke_off])
            bar.update()
    return [Trajectory(np.array(rows), *others) for rows, *others in (store.rows[sample.key] for sample in samples)]
