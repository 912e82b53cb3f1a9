"""Branches of a run: episodes of one scene have the ticks before their onsets in common, and run them once.

The closed loop is deterministic, so that two episodes which differ in the disturbance alone are the same to the bit
until the first onset. A clone of the root Context from there goes on with the other's disturbance.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import Context

from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.record import Record
from diagrams.world.disturbance import DisturbanceSpec

if TYPE_CHECKING:
    from diagrams.episodes.rollout import Rollout

# Distance to the goal at which a clone is kept, m, by subtask: the earliest onset that is sampled (ONSET_LEVELS). A
# clone to keep costs as much as 4 ticks, to begin with one as much as 7: subtask 1, whose onsets come after 20 to 50
# ticks, would gain next to nothing; of subtask 2 it saves 170 of 400 to 700.
BRANCH_LEVELS = {2: 0.16}
SCENES = 40  # whose clones are kept, each of 12 MB


@dataclass(frozen=True)
class Prefix:
    """The ticks of a run before `level` was first reached in `subtask`, undisturbed, alpha below 1/2."""

    context: Context  # the root's, half a plant step before the tick at which it is reached
    rows: dict[str, list[Any]]  # of the ticks before, by the names of Record
    subtask: int
    level: float  # m

    @property
    def ticks(self) -> int:
        """How many it saves."""
        return len(self.rows["alpha"])

    def serves(self, given: DisturbanceSpec) -> bool:
        """Whether a run of the same scene under `given` begins with it: its onset is not before."""
        return given.subtask == self.subtask and given.level is not None and given.level <= self.level


class Branches:
    """Runs episodes with one controller; of the last SCENES scenes, those that can begin with a clone do so."""

    def __init__(self, rollout: "Rollout"):
        self._rollout, self._kept = rollout, dict[Any, Prefix]()

    def run(self, episode: Episode, **options: Any) -> tuple[Outcome, Record, int]:
        """As `Rollout.run`; and the number of ticks that were not run, because a clone began after them."""
        given = episode.disturbance
        scene = (episode.can_xy, episode.vacant, given.subtask)
        start = self._kept.get(scene)
        if start is not None and not start.serves(given):
            start = None

        def keep(prefix: Prefix) -> None:
            while len(self._kept) >= SCENES:
                del self._kept[next(iter(self._kept))]  # the oldest
            self._kept[scene] = prefix

        new = scene not in self._kept and given.subtask in BRANCH_LEVELS
        outcome, record = self._rollout.run(episode, start=start, keep=keep if new else None, **options)
        return outcome, record, start.ticks if start is not None else 0
