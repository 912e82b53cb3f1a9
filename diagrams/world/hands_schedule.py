"""What a person's hands did in a run, tick by tick, as a scenario file holds it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from diagrams.world.names import ARM_JOINTS
from models.errors import InputError
from systems.manual_disturbance import FREE, HOLD, MOVE

LARGEST_FORCE = 60.0  # N, a component of a pull at the hand
GAMMAS = 1.0, 10_000.0  # smallest and largest that can be chosen
LARGEST_TICK = 1_000_000  # to which a run would go on
# By the names of HandsSchedule, the values before the first change.
INITIAL = {
    "grip": [FREE] + [0.0] * ARM_JOINTS, "force": [0.0] * 3, "can": [math.nan] * 2, "camera": [0.0],
    "gamma": [math.nan], "late": [0.0],
}  # fmt: skip


@dataclass
class HandsSchedule:
    """What a person did in a run: rows of the tick from which on something holds, and its values. Ticks rise."""

    grip: list[list[float]] = field(default_factory=list)  # 0 free, 1 held, 2 moved to the joint angles (rad) after it
    force: list[list[float]] = field(default_factory=list)  # x, y, z at the hand, N, world
    can: list[list[float]] = field(default_factory=list)  # in that tick alone, x and y where it is put, m, world
    camera: list[list[float]] = field(default_factory=list)  # place in systems.camera_fault.FAULTS
    gamma: list[list[float]] = field(default_factory=list)  # of the detector, instead of its own
    late: list[list[float]] = field(default_factory=list)  # share of the controller's steps that are late, 0 to 1

    def __bool__(self) -> bool:
        """Whether anything was done."""
        return any(vars(self).values())

    @property
    def last_tick(self) -> int:
        """The last tick at which something changed; 0: nothing ever did."""
        return int(max((rows[-1][0] for rows in vars(self).values() if rows), default=0))

    def check(self) -> None:
        """Raises InputError for rows that are no changes, or that the page would have refused.

        Postures and places depend on the world: EpisodeSampler looks at them.
        """
        for name, rows in vars(self).items():
            before = -1.0
            for row in rows:
                if len(row) != 1 + len(INITIAL[name]) or not np.all(np.isfinite(row)):
                    wanted = f"a tick and {len(INITIAL[name])} finite numbers"
                    raise InputError(f"hands.{name} has the row {row}: give {wanted}")
                if row[0] != int(row[0]) or row[0] <= before:
                    raise InputError(f"hands.{name} has the tick {row[0]} after {before}: give whole ones that rise")
                if row[0] > LARGEST_TICK:
                    raise InputError(f"hands.{name} has the tick {row[0]:g}: give at most {LARGEST_TICK}")
                before = row[0]
        for name, allowed in (("grip", (FREE, HOLD, MOVE)), ("camera", range(_faults() if self.camera else 0))):
            for row in getattr(self, name):
                if row[1] not in allowed:
                    raise InputError(f"hands.{name} has the kind {row[1]}: choose from {[int(k) for k in allowed]}")
        for row in self.force:
            require_force(row[1:])
        for row in self.gamma:
            require_gamma(row[1])
        for row in self.late:
            require_share(row[1])


def require_force(force: Sequence[float] | np.ndarray) -> None:
    """Raises InputError for a pull (3,), N, that is beyond LARGEST_FORCE."""
    if not np.all(np.abs(force) <= LARGEST_FORCE):
        numbers = [float(each) for each in force]
        raise InputError(f"the force {numbers} N is too large: choose at most {LARGEST_FORCE} N a component")


def require_gamma(gamma: float) -> None:
    """Raises InputError outside of GAMMAS."""
    if not GAMMAS[0] <= gamma <= GAMMAS[1]:
        raise InputError(f"gamma {gamma} is outside of {GAMMAS[0]:g} to {GAMMAS[1]:g}: choose one inside")


def require_share(share: float) -> None:
    """Raises InputError for a share of late steps outside of [0, 1]."""
    if not 0.0 <= share <= 1.0:
        raise InputError(f"the share of late steps {share} is no share: choose 0 to 1")


def _faults() -> int:
    """How many faults a camera may have. Not imported above: it loads Drake's plant, before any words."""
    from systems.camera_fault import FAULTS

    return len(FAULTS)
