"""Adaptive multilevel splitting for a static distribution: the probability of a rare event, by steps that are not rare.

Subset simulation (Au and Beck 2001) as Cerou, Del Moral, Furon, Guyader have it, "Sequential Monte Carlo for rare event
estimation", Statistics and Computing 22, 2012. Points are standard normal numbers; the event is that the level of a
point is at least `target`. A population of n points is drawn. At each stage those stay whose level is above the
stage's; each is copied as often as the others, and every copy is moved by a kernel that is reversible for the
distribution, a move being taken only where the level stays above the stage's. With K_k points above in stage k and M
that reach the target after the last one, the estimate is prod_k (K_k / n) (M / n).

The levels are those of a pilot run, which takes them from its own population: each such that the share `kept` is above
it. The estimate of the pilot is biased by that, by the more the less the copies move, and is not used. With levels that
are given the estimate is unbiased, whatever the moves (Botev and Kroese, "Efficient Monte Carlo simulation via the
generalized splitting method", Statistics and Computing 22, 2012, who do the same).

Ties: above means strictly above. Where several points share the level that would part them, they stay or go together,
as is nearer to `kept`. A pilot whose whole population has one level short of the target ends its levels there, and also
once what is above them is as rare as is asked for.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from models.errors import InputError

Evaluate = Callable[[np.ndarray], np.ndarray]  # points (m, d) -> their levels (m,)
MOST_STAGES = 100
LEAST_KEPT = 1e-3  # share of a population


@dataclass(frozen=True)
class Kernel:
    """A move that is reversible for the standard normal distribution: preconditioned Crank-Nicolson, block by block.

    (Cotter, Roberts, Stuart, White, "MCMC methods for functions", Statistical Science 28, 2013.)

    A block that is moved becomes sqrt(1 - s^2) x + s xi, with one s of `steps` for all of them and xi fresh; with s = 1
    it is drawn anew. Which blocks and which s does not depend on the point.
    """

    blocks: Sequence[np.ndarray]  # columns
    chances: Sequence[float]  # that a block is moved; where none is, one of them is drawn
    steps: Sequence[float] = (0.25, 0.5, 1.0)

    def propose(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """(m, d) where the `points` (m, d) would move to."""
        moved = rng.random((len(points), len(self.blocks))) < self.chances
        one = rng.integers(len(self.blocks), size=len(points))
        none = ~moved.any(axis=1)
        moved[none, one[none]] = True
        step = rng.choice(self.steps, size=len(points))[:, None]
        fresh, found = rng.standard_normal(points.shape), points.copy()
        for i, columns in enumerate(self.blocks):
            rows = np.flatnonzero(moved[:, i])
            s = step[rows]
            found[np.ix_(rows, columns)] = (
                np.sqrt(1.0 - s**2) * points[np.ix_(rows, columns)] + s * fresh[np.ix_(rows, columns)]
            )
        return found


@dataclass(frozen=True)
class Stage:
    """One stage: its level, the share of the population above it, and the share of the moves that were taken."""

    level: float
    share: float
    taken: float


@dataclass
class Splitting:
    """What came of one run."""

    estimate: float
    stages: list[Stage]
    evaluations: int
    extinct: bool  # no point is left above a level, or at the target
    smallest: float  # the estimate that one point alone of the last population would have given
    # Of the evaluations, numbered from 0 as they were asked for: those that some point died or ended with, each with
    # the probability that it stands for. Their sum is 1, and sum of weight f estimates the mean of any f.
    weights: list[tuple[int, float]] = field(default_factory=list)


def above_level(run: Splitting, number: int) -> float:
    """What the run says of the probability of a point above its level of that number, from 0 on."""
    return math.prod(stage.share for stage in run.stages[: number + 1]) if number < len(run.stages) else 0.0


def split(
    evaluate: Evaluate,
    kernel: Kernel,
    size: int,
    target: float,
    *,
    population: int,
    kept: float,
    moves: int,
    rng: np.random.Generator,
    levels: Sequence[float] | None = None,
    rarest: float = 0.0,
    on_stage: Callable[[Stage], object] = lambda stage: None,
) -> Splitting:
    """One run, see above; all that is random comes from `rng`.

    Args:
        size: numbers of a point, d.
        population: n.
        kept: share that stays, in (0, 1); with `levels` it is not read.
        moves: of each point, a stage.
        levels: of the stages, rising, below the target; None: a pilot.
        rarest: a probability; what is rarer a pilot does not look for.
        on_stage: is told each stage.

    Raises InputError for sizes that make no run, and after MOST_STAGES stages.
    """
    require_sizes(population, kept, moves)
    points = rng.standard_normal((population, size))
    found, numbers = _levels(evaluate, points), np.arange(population)
    evaluations, weight, stages, weights = population, 1.0, list[Stage](), list[tuple[int, float]]()
    given = None if levels is None else iter(levels)

    def next_level() -> float | None:
        if given is not None:
            return next(given, None)
        return stage_level(found, kept, target) if weight > rarest else None

    while (level := next_level()) is not None:
        if len(stages) == MOST_STAGES:
            raise InputError(
                f"the levels do not reach {target:g} in {MOST_STAGES} stages (now {level:g}): raise --moves, "
                "or lower --kept"
            )
        above = found > level
        weights += [(int(number), weight / population) for number in numbers[~above]]
        if not above.any():
            return Splitting(0.0, stages, evaluations, True, weight / population, weights)
        source = copies(np.flatnonzero(above), population, rng)
        points, found, numbers, taken = points[source], found[source], numbers[source], 0
        for _ in range(moves):
            proposed = kernel.propose(points, rng)
            values = _levels(evaluate, proposed)
            better = values > level
            points[better], found[better] = proposed[better], values[better]
            numbers[better] = evaluations + np.flatnonzero(better)
            evaluations += population
            taken += int(better.sum())
        share = float(above.mean())
        weight *= share
        stages.append(Stage(float(level), share, taken / (moves * population)))
        on_stage(stages[-1])
    reached = int(np.sum(found >= target))
    share = weight / population
    weights += [(int(number), share) for number in numbers]
    return Splitting(share * reached, stages, evaluations, reached == 0, share, weights)


def copies(alive: np.ndarray, population: int, rng: np.random.Generator) -> np.ndarray:
    """(population,) of `alive` (K,), each as often as the others, but for what is left over: drawn, each once."""
    left = rng.choice(alive, size=population % len(alive), replace=False)
    return np.append(np.repeat(alive, population // len(alive)), left)


def stage_level(levels: np.ndarray, kept: float, target: float) -> float | None:
    """The level of a pilot's next stage, which at least one of `levels` (n,) is above.

    None where so many as are asked for reach the target, or where all levels are one.
    """
    asked = max(round(kept * len(levels)), 1)
    order = np.sort(levels)[::-1]
    if order[asked - 1] >= target:
        return None
    values = np.unique(levels)[:-1]  # above each of these there is a level
    if not len(values):
        return None
    above = np.array([np.sum(levels > value) for value in values])
    return float(values[len(values) - 1 - np.argmin(np.abs(above - asked)[::-1])])


def require_sizes(population: int, kept: float, moves: int) -> None:
    """Raises InputError for sizes that make no run."""
    if not LEAST_KEPT <= kept <= 1.0 - LEAST_KEPT:
        words = f"choose a number from {LEAST_KEPT:g} to {1.0 - LEAST_KEPT:g}, such as 0.2"
        raise InputError(f"--kept {kept:g} is no share of a population: {words}")
    least = int(np.ceil(1.0 / min(kept, 1.0 - kept)))
    if population < least:
        raise InputError(f"--population {population} is too small to keep a share of {kept:g}: choose {least} or more")
    if moves < 1:
        raise InputError(f"--moves {moves} is too small: choose 1 or more")


def _levels(evaluate: Evaluate, points: np.ndarray) -> np.ndarray:
    levels = np.array(evaluate(points.copy()), dtype=float)
    if levels.shape != (len(points),) or np.isnan(levels).any():
        raise ValueError(f"levels are {levels}; they must be {len(points)} numbers: return one for each point.")
    return levels
