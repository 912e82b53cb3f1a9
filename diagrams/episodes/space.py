"""The distribution of EpisodeSampler under one kind of disturbance, as a map from standard normal numbers to episodes.

What is moved a little in these coordinates, reversibly for the normal distribution, moves an episode a little and keeps
the distribution: that is what Markov chains over episodes need.

Where the sampler draws again, here the first of CANDIDATES is taken that will do, each with coordinates of its own. So
no episode is more probable because others beside it are impossible: in each scene and at each moment the map gives what
the sampler gives. It differs by the points none of whose candidates will do, which have no episode: see CANDIDATES.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.special import ndtr

from diagrams.episodes.episode import Episode
from diagrams.episodes.sampling import (
    CAN_TAKEN_SHARE,
    DEFLECTED_JOINTS,
    DEFLECTION_DEG,
    HELD_TICKS,
    ONSET_LEVELS,
    STOP_TICKS,
    XY,
    EpisodeSampler,
)
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import ARM_JOINTS, SPOTS
from models.errors import InputError

# Of 4,000 places of the grid's bounds 60 % are unlearned: without one among 24 is a point in 3e9.
PLACES, TARGETS = 24, 64  # candidates for a can's place and for A's target
TARGET_NUMBERS = 1 + 3 * ARM_JOINTS  # how many joints; which ones, to which side, how far


class EpisodeSpace:
    """Episodes of one kind of disturbance by points of a standard normal space.

    `size`: numbers of a point. `blocks`: columns that have one meaning, by its name.
    """

    def __init__(self, world: World, kind: str, rnn: str = "lstm", detector: str = "recall"):
        """`kind`: A or B; raises InputError for another."""
        if kind not in ("A", "B"):
            raise InputError(f"a disturbance '{kind}' has no space of episodes: choose A or B")
        self._sampler, self._kind, self._controller = EpisodeSampler(world), kind, (rnn, detector)
        self._lower, self._upper = world.grid.bounds
        sizes = {"scene": 2 * PLACES + 1, "moment": 2}
        sizes |= {"target": TARGETS * TARGET_NUMBERS} if kind == "A" else {"hold": 1, "taken": 1 + 2 * PLACES}
        edges = np.cumsum([0, *sizes.values()])
        self.size = int(edges[-1])
        self.blocks = {name: np.arange(a, b) for name, a, b in zip(sizes, edges[:-1], edges[1:], strict=True)}

    def episode(self, point: np.ndarray) -> Episode | None:
        """The episode of `point` (size,); None where no candidate will do. Its seed, 0, has no meaning."""
        part = {name: point[columns] for name, columns in self.blocks.items()}
        can_xy, vacant = self._place(part["scene"][1:]), SPOTS[int(part["scene"][0] > 0.0)]
        subtask = 1 + int(part["moment"][0] > 0.0)
        lowest, highest = ONSET_LEVELS[subtask]
        level = float(lowest + (highest - lowest) * ndtr(part["moment"][1]))
        if can_xy is None:
            return None
        approach = self._sampler.approach(subtask, can_xy, vacant)
        left_at = start = approach.joints_at(level)
        if self._kind == "A":
            targets = (start + offset(numbers) for numbers in part["target"].reshape(TARGETS, TARGET_NUMBERS))
            target = _first(targets, lambda target: self._sampler.comes_freely(start, target))
            if target is None:
                return None
            left_at, given = target, DisturbanceSpec("A", level, target.tolist(), HELD_TICKS, subtask)
        else:
            moved = None
            if subtask == 2 and ndtr(part["taken"][0]) < CAN_TAKEN_SHARE:
                elsewhere = self._place(part["taken"][1:])
                if elsewhere is None:
                    return None
                moved = list(elsewhere)
            hold = int(whole(STOP_TICKS, part["hold"][0]))
            given = DisturbanceSpec("B", level, None, hold, subtask, moved)
        clear = self._sampler.way_home_clear(given, left_at, vacant)
        return Episode(0, can_xy, vacant, given, *self._controller, clear)

    def _place(self, numbers: np.ndarray) -> XY | None:
        places = self._lower + (self._upper - self._lower) * ndtr(numbers.reshape(PLACES, 2))
        xy = _first(places, self._sampler.unlearned)
        return None if xy is None else (float(xy[0]), float(xy[1]))


def whole(bounds: tuple[int, int], number: np.ndarray | float) -> np.ndarray:
    """Of a standard normal `number` a uniform whole one within `bounds`, inclusive."""
    least, most = bounds
    return least + np.minimum(np.floor((most - least + 1) * ndtr(number)), most - least).astype(int)


def offset(numbers: np.ndarray) -> np.ndarray:
    """(7,) rad: how A's target is off the posture at the onset; `numbers`: (TARGET_NUMBERS,) standard normal."""
    order, side, far = numbers[1:].reshape(3, ARM_JOINTS)
    joints = np.argsort(order)[: whole(DEFLECTED_JOINTS, numbers[0])]
    least, most = DEFLECTION_DEG
    found = np.zeros(ARM_JOINTS)
    found[joints] = np.where(side > 0.0, 1.0, -1.0)[joints] * np.deg2rad(least + (most - least) * ndtr(far[joints]))
    return found


def _first(candidates: Iterable[np.ndarray], will_do: Callable[[np.ndarray], bool]) -> np.ndarray | None:
    return next((candidate for candidate in candidates if will_do(candidate)), None)
