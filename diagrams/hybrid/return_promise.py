"""What is promised of V on ways home: rates that the servo's error is measured into, with a safety factor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from models.errors import InputError

SAFETY_FACTOR = 1.5  # on what the servo adds to the ideal rate


def contractions(values: np.ndarray, at_home: float) -> tuple[np.ndarray, np.ndarray]:
    """V[k+1] / V[k] along a way home, as long as V is above `at_home`: of the first tick, (0 or 1,), and of the others.

    `values`: V at the ticks.
    """
    ratios = values[1:] / np.where(values[:-1] > at_home, values[:-1], np.inf)
    counted = values[:-1] > at_home
    return ratios[:1][counted[:1]], ratios[1:][counted[1:]]


@dataclass(frozen=True)
class Promise:
    """How V falls from the postures of one set, at least: see `first`, and by the factor `later` in each tick after."""

    excess: float  # over the ideal rates, a tick, the safety factor included
    later: float
    farthest: float  # the ideal factor of the first tick at most, from anywhere in the set
    apart: bool  # nothing is known of the first tick but that V does not rise
    calibrated: int  # free ways that it was measured on

    @classmethod
    def measured(
        cls,
        values: Sequence[np.ndarray],
        ideal_first: Sequence[float],
        ideal: float,
        farthest: float,
        at_home: float,
        apart: bool,
    ) -> Self:
        """The ideal rates plus SAFETY_FACTOR times the largest excess over them, as long as V is above `at_home`.

        Args:
            values: V at the ticks of each free way.
            ideal_first: factor of each of these, of its first tick; ideal: of every other tick.
            farthest: `ideal_first` at most, from anywhere in the set.
            apart: not of the first ticks, for which the promise is 1, that V does not rise: where far joints start
                together their torques hold a near one back, by how much has a long tail.

        Raises InputError where no way is free, and where nothing is left of the contraction.
        """
        firsts, laters = zip(*(contractions(v, at_home) for v in values), strict=True) if values else ((), ())
        if not any(map(len, firsts)):
            raise InputError(
                "none of the ways home to measure the rate on is free, of contact and of the filter: "
                "raise --samples and --draws"
            )

        over = [float(np.max(rates, initial=0.0)) - ideal for rates in laters]
        if not apart:
            over += [float(np.max(r, initial=0.0)) - known for r, known in zip(firsts, ideal_first, strict=True)]
        excess = SAFETY_FACTOR * max(0.0, *over)
        later = ideal + excess
        if later >= 1.0:
            raise InputError(
                f"the servo follows so badly that V would fall to {later:.3f} of itself a tick only: choose stiffer "
                "world.servo gains, or a larger world.regulator.input_weight"
            )
        return cls(excess, later, farthest, apart, len(values))

    def first(self, ideal: np.ndarray) -> np.ndarray:
        """(n,) the factor of the first tick at most, from postures with these `ideal` ones (n,)."""
        return np.ones(len(ideal)) if self.apart else np.minimum(ideal + self.excess, 1.0)

    @property
    def slowest(self) -> float:
        """`first` from anywhere in the set, at most."""
        return float(self.first(np.array([self.farthest]))[0])

    def bound(self, ticks: int) -> np.ndarray:
        """(ticks + 1,) V at most after each tick, from 1."""
        return np.append(1.0, self.slowest * self.later ** np.arange(ticks))

    def ticks_home(self, at_home: float) -> int:
        """After which V is at most `at_home`, from 1."""
        return 1 + max(0, int(np.ceil(np.log(at_home / self.slowest) / np.log(self.later))))
