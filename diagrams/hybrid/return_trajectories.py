"""Trajectories home from many postures, over worker processes; one broken off goes on where it was."""

import numpy as np

from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.store import RowStore
from diagrams.hybrid.return_loop import ReturnLoop, Trajectory
from diagrams.hybrid.return_samples import Sample
from diagrams.world.configuration import World


def run_job(job: tuple[World, Sample]) -> Trajectory:
    """The trajectory of a sample; the diagram is built once in a process."""
    world, sample = job
    loop = kept_in_thread(("return loop", repr(world)), lambda: ReturnLoop(world))
    return loop.run(np.array(sample.joints), np.array(sample.can_xy), sample.vacant, sample.held)


def trajectories_home(world: World, samples: list[Sample], pool: Pool, store: RowStore, title: str) -> list[Trajectory]:
    """The trajectory of each sample, in their order; what is in the store is not run again; `title`: of the bar."""
    from tqdm import tqdm

    missing = [(world, sample) for sample in samples if sample.key not in store.rows]
    known = len(samples) - len(missing)
    with tqdm(total=len(samples), initial=known, desc=title, unit="posture", disable=None) as bar:
        for (_, sample), found in pool.run(run_job, missing):
            store.add(sample.key, found.row())
            bar.update()
    return [store.read(sample.key, Trajectory.of_row) for sample in samples]
