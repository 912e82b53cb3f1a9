"""What a person's hands did in a run, tick by tick, as a scenario file holds it."""

import math
from dataclasses import dataclass, field

import numpy as np

from diagrams.world.names import ARM_JOINTS
from models.errors import InputError
from systems.manual_disturbance import FREE, HOLD, MOVE

# By the names of HandsSchedule, the values before the first change.
INITIAL = {
    "grip": [FREE] + [0.0] * ARM_JOINTS, "force": [0.0] * 3, "can": [math.nan] * 2, "camera": [0.0],
    "gamma": [math.nan],
}  # fmt: skip


@dataclass
class HandsSchedule:
    """What a person did in a run: rows of the tick from which on something holds, and its values. Ticks rise."""

    grip: list[list[float]] = field(default_factory=list)  # 0 free, 1 held, 2 moved to the joint angles (rad) after it
    force: list[list[float]] = field(default_factory=list)  # x, y, z at the hand, N, world
    can: list[list[float]] = field(default_factory=list)  # in that tick alone, x and y where it is put, m, world
    camera: list[list[float]] = field(default_factory=list)  # place in systems.camera_fault.FAULTS
    gamma: list[list[float]] = field(default_factory=list)  # of the detector, instead of its own

    def __bool__(self) -> bool:
        """Whether anything was done."""
        return any(vars(self).values())

    @property
    def last_tick(self) -> int:
        """The last tick at which something changed; 0: nothing ever did."""
        return int(max((rows[-1][0] for rows in vars(self).values() if rows), default=0))

    def check(self) -> None:
        """Raises InputError for rows that are no changes."""
        for name, rows in vars(self).items():
            before = -1.0
            for row in rows:
                if len(row) != 1 + len(INITIAL[name]) or not np.all(np.isfinite(row)):
                    wanted = f"a tick and {len(INITIAL[name])} finite numbers"
                    raise InputError(f"hands.{name} has the row {row}: give {wanted}")
                if row[0] != int(row[0]) or row[0] <= before:
                    raise InputError(f"hands.{name} has the tick {row[0]} after {before}: give whole ones that rise")
                before = row[0]
        for name, allowed in (("grip", (FREE, HOLD, MOVE)), ("camera", range(_faults() if self.camera else 0))):
            for row in getattr(self, name):
                if row[1] not in allowed:
                    raise InputError(f"hands.{name} has the kind {row[1]}: choose from {[int(k) for k in allowed]}")
        if any(row[1] <= 0.0 for row in self.gamma):
            raise InputError("hands.gamma has a value that is not greater than 0: give one that is")


def _faults() -> int:
    """How many faults a camera may have. Not imported above: it loads Drake's plant, before any words."""
    from systems.camera_fault import FAULTS

    return len(FAULTS)
