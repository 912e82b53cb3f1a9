"""The episodes whose straight way home from the disturbance touches something: 1 in 10 under B, 1 in 50 under A."""

from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.sampling import SEEDS_APART, EpisodeSampler, episode_seeds
from diagrams.world.configuration import World
from models.errors import InputError

BATCH = 20  # seeds that a worker looks at


def _blocked(job: tuple[World, str, list[int]]) -> list[int]:
    """Those of the seeds of a job."""
    world, kind, seeds = job
    sampler = kept_in_thread(("sampler", repr(world)), lambda: EpisodeSampler(world))
    return [seed for seed in seeds if sampler.sample(seed, kind).way_home_clear is False]


def require_takes_arm(kinds: list[str]) -> None:
    """Raises InputError for a kind of disturbance that does not take the arm."""
    for kind in kinds:
        if kind not in ("A", "B"):
            raise InputError(f"from a disturbance '{kind}' there is no way home that could be blocked: choose A or B")


def blocked_seeds(world: World, purpose: str, seed: int, count: int, kind: str, workers: int) -> list[int]:
    """The first `count` seeds of `episode_seeds` whose straight way home from a disturbance `kind` touches something.

    Raises InputError where fewer are blocked; `kind`: see `require_takes_arm`.
    """
    from tqdm import tqdm

    seeds, found = episode_seeds(purpose, seed, SEEDS_APART), list[int]()
    each = BATCH * max(workers, 1)
    with Pool(workers) as pool, tqdm(total=count, desc=f"blocked ways home, {kind}", leave=False, disable=None) as bar:
        for start in range(0, len(seeds), each):
            jobs = [(world, kind, seeds[i : i + BATCH]) for i in range(start, start + each, BATCH)]
            found += sorted(seed for _, blocked in pool.run(_blocked, jobs) for seed in blocked)
            bar.n = min(len(found), count)
            bar.refresh()
            if len(found) >= count:
                return found[:count]
    raise InputError(
        f"of the {SEEDS_APART} episodes of {purpose} seed {seed}, {len(found)} have a way home from {kind} that is "
        f"blocked: choose at most {len(found)} of them"
    )
