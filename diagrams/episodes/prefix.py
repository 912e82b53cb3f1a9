"""Prefix: the beginning of a run that every episode of its scene with a later onset has in common.

The closed loop is deterministic, so that two episodes which differ in the disturbance alone are the same to the bit
until the first onset. A clone of the root Context from there goes on with the other's disturbance.
"""

from dataclasses import dataclass
from typing import Any, Self

from pydrake.systems.framework import Context

from diagrams.world.disturbance import DisturbanceSpec

# Distance to the goal at which a clone is kept, m, by subtask: the earliest onset that is sampled (ONSET_LEVELS). A
# clone to keep costs as much as 4 ticks, to begin with one as much as 7: subtask 1, whose onsets come after 20 to 50
# ticks, would gain next to nothing; of subtask 2 it saves 170 of 400 to 700.
BRANCH_LEVELS = {2: 0.16}


@dataclass(frozen=True)
class Prefix:
    """The ticks of a run before `level` was first reached in `subtask`, undisturbed, alpha below 1/2."""

    context: Context  # the root's, half a plant step before the tick at which it is reached
    rows: dict[str, list[Any]]  # of the ticks before, by the names of Record
    subtask: int
    level: float  # m

    @classmethod
    def taken(cls, root: Context, rows: dict[str, list[Any]], subtask: int) -> Self:
        """Where the run is now, with copies of what goes on."""
        return cls(root.Clone(), {name: list(values) for name, values in rows.items()}, subtask, BRANCH_LEVELS[subtask])

    @property
    def ticks(self) -> int:
        """How many it saves."""
        return len(self.rows["alpha"])

    def serves(self, given: DisturbanceSpec) -> bool:
        """Whether a run of the same scene under `given` begins with it: its onset is not before."""
        return given.subtask == self.subtask and given.level is not None and given.level <= self.level
