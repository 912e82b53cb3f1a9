"""Cases of the search for the probability of defeat: each episode is run once, and its row is kept."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Self

from tqdm import tqdm

from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.pool import Pool
from diagrams.episodes.record import Record, record_hash
from diagrams.episodes.runner import Job, run_branched, run_episode
from diagrams.episodes.store import RowStore, of_plain
from diagrams.episodes.switching import Until
from diagrams.hybrid.severity import moved_deg, severity


@dataclass(frozen=True)
class Case:
    """What came of one episode."""

    episode: Episode
    level: float  # see severity.py
    failure: str | None  # of the switching
    task_done: bool | None  # None: not asked for
    void: bool
    moved_deg: float  # norm of the move from the command at the onset, as it came; 0 under B
    ticks: int  # of the whole episode
    saved: int  # of them, by beginning with a clone
    record_hash: str

    @classmethod
    def of(
        cls, episode: Episode, outcome: Outcome, record: Record, saved: int, gamma: float, until: Until = "task"
    ) -> Self:
        """`gamma`: the threshold of the record's errors; `until`: what the run ended with."""
        done = bool(outcome.success) if until == "task" else None
        return cls(
            episode, severity(outcome, record, gamma, until), outcome.switch_failure, done, outcome.void,
            moved_deg(episode.disturbance.target, record), len(record.time), saved, record_hash(record),
        )  # fmt: skip

    @classmethod
    def of_row(cls, row: dict[str, Any]) -> Self:
        """From a row of the store: what `asdict` made of a case."""
        case: Self = of_plain(cls, row)
        return case


def run_case(job: tuple[Job, float, bool]) -> Case:
    """In a worker: the job's episode, with gamma, and whether it may begin with a clone."""
    given, gamma, branch = job
    assert given.episode is not None
    if branch:
        outcome, record, saved = run_branched(given)
    else:
        (outcome, record), saved = run_episode(given), 0
    return Case.of(given.episode, outcome, record, saved, gamma, given.until)


class Cases:
    """The cases of one controller: those in the store, and what is run beside them."""

    def __init__(self, job: Job, gamma: float, branch: bool, store: RowStore, pool: Pool):
        """`job`: without an episode; `gamma`: see Case; `branch`: begin with clones where that can be."""
        self._job, self._gamma, self._branch, self._store, self._pool = job, gamma, branch, store, pool

    def run(self, episodes: Sequence[Episode], bar: tqdm) -> list[Case]:
        """Of each of `episodes`; those that are new are run. `bar`: is told each of these."""
        new = {repr(e): e for e in episodes if repr(e) not in self._store.rows}
        for (job, _, _), case in self._pool.run(run_case, [self._of(episode) for episode in new.values()]):
            self._store.add(repr(job.episode), asdict(case))
            bar.update()
        return [self._store.read(repr(episode), Case.of_row) for episode in episodes]

    def again(self, case: Case) -> bool:
        """Whether the whole episode, from tick 0, gives the bits of `case`."""
        job, gamma, _ = self._of(case.episode)
        [(_, found)] = self._pool.run(run_case, [(job, gamma, False)])
        return found.record_hash == case.record_hash

    def _of(self, episode: Episode) -> tuple[Job, float, bool]:
        job = self._job
        return replace(job, episode=episode), self._gamma, self._branch
