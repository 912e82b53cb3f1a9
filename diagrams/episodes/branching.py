"""Branches of a run: episodes of one scene have the ticks before their onsets in common, and run them once."""

from typing import TYPE_CHECKING, Any

from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.prefix import BRANCH_LEVELS, Prefix
from diagrams.episodes.record import Record

if TYPE_CHECKING:
    from diagrams.episodes.rollout import Rollout

SCENES = 40  # whose clones are kept, each of 12 MB


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
