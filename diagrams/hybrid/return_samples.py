"""From where ways home are simulated: postures in the box, and those where a disturbance meets or leaves the arm."""

import json
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.episodes.store import RowStore, of_plain
from diagrams.hybrid.box_gauge import BoxGauge
from diagrams.world.clearance_map import ClearanceMap
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, SPOTS

APART = 0.01  # m: a posture nearer to something is no sample


@dataclass(frozen=True)
class Sample:
    """A posture at rest in a scene, from which the arm is brought home; of plain types."""

    joints: tuple[float, ...]  # 7, rad
    can_xy: tuple[float, float]  # m, world: where the can stands if it is not held
    vacant: str
    held: bool  # the can is in the hand

    @property
    def key(self) -> str:
        """Of its row in a store."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, row: dict[str, Any]) -> Self:
        """From the dictionary of its fields, as JSON gives it; raises ValueError, TypeError where it is none."""
        sample: Self = of_plain(cls, row)
        if len(sample.joints) != ARM_JOINTS or sample.vacant not in SPOTS:
            raise ValueError("no sample")
        return sample


def box_samples(
    world: World, gauge: BoxGauge, count: int, rng: np.random.Generator, border: bool = False
) -> list[Sample]:
    """`count` postures, uniform in the box, the can in the hand in every second.

    `border`: moved away from home onto the border of the box, where the steps are largest.
    One in which the arm, or the can that it holds, is nearer than APART to desk, shelf, a can or its own foot is
    sampled again.
    """
    from tqdm import tqdm

    checker, own, home = CollisionChecker(world, APART), ClearanceMap(world), world.initial_posture[:ARM_JOINTS]
    corner, opposite = world.grid.bounds
    samples: list[Sample] = []
    with tqdm(total=count, desc="postures in the box", leave=False, disable=None) as bar:
        while len(samples) < count:
            deviation, xy = gauge.sample(rng), rng.uniform(corner, opposite)
            joints = home + (gauge.to_border(deviation) if border else deviation)
            held = len(samples) % 2 == 1
            sample = Sample(tuple(joints.tolist()), (float(xy[0]), float(xy[1])), str(rng.choice(SPOTS)), held)
            checker.set_scene(None if held else sample.can_xy, sample.vacant)
            posture = np.append(joints, world.closed_opening if held else world.opening)
            if checker.first_touch(joints) is None and own.from_foot(posture) >= APART:
                samples.append(sample)
                bar.update()
    return samples


def run_draw(job: tuple[World, int]) -> tuple[Sample, Sample]:
    """Of the episode of a seed under disturbance A: the posture at its onset, and the one that the arm is moved to."""
    world, seed = job
    sampler = kept_in_thread(("episode sampler", repr(world)), lambda: EpisodeSampler(world))
    episode = sampler.sample(seed, "A")
    scene = episode.can_xy, episode.vacant, episode.disturbance.subtask == 2
    onset = tuple(sampler.onset_posture(episode).tolist())
    return Sample(onset, *scene), Sample(tuple(episode.disturbance.target or ()), *scene)


def drawn_samples(
    world: World, seeds: list[int], pool: Pool, store: RowStore, title: str
) -> tuple[list[Sample], list[Sample]]:
    """The onsets, and the targets, of the episodes of `seeds`, as EpisodeSampler draws them; see `run_draw`.

    What is in the store is not drawn again; `title`: of the bar.
    """
    from tqdm import tqdm

    def key(seed: int) -> str:
        return f"episode {seed}"

    missing = [(world, seed) for seed in seeds if key(seed) not in store.rows]
    with tqdm(total=len(seeds), initial=len(seeds) - len(missing), desc=title, unit="episode", disable=None) as bar:
        for (_, seed), pair in pool.run(run_draw, missing):
            store.add(key(seed), [asdict(sample) for sample in pair])
            bar.update()

    def pair_of(rows: list[dict[str, Any]]) -> tuple[Sample, Sample]:
        onset, target = map(Sample.of, rows)
        return onset, target

    pairs = [store.read(key(seed), pair_of) for seed in seeds]
    return [onset for onset, _ in pairs], [target for _, target in pairs]
