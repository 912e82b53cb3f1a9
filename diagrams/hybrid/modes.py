"""The switched loop as a hybrid automaton: its modes, guard crossings, dwell times and resets, measured on records.

Mode `task` (alpha < 1/2): the network moves the arm and sees it. Mode `return` (alpha >= 1/2): the LQR moves the arm,
the network runs on its own predictions, and begins anew in c_0 at each tick at which the arm is at home (but for
`world.resumption: imagined`). The guard is alpha = 1/2. Crossing it back resets the network's input from what it
predicted to what is measured, at that tick: at the switching point the two should be the same.

Nothing in the law bounds the crossings but the tick: alpha has one value a tick, so that there are ten a second at
most. That they are few is no theorem but what is measured here: after a crossing the error is far from the threshold.
"""

from collections import Counter
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from diagrams.episodes.record import PICTURE_EVERY, Record, find_records, load_record, save_record
from diagrams.episodes.switching import GUARD
from diagrams.hybrid.common import NetworkArguments
from diagrams.world.names import ARM_JOINTS
from models.checks import Range

TASK, RETURN = "task", "return"


@dataclass
class Modes(NetworkArguments):
    """The automaton of runs: modes, guard crossings, dwell times, resets; no run shows chatter."""

    records: list[Path] = field(default_factory=list)  # record files, or folders of them; none: runs an episode
    disturbance: Literal["none", "A", "B"] = "A"  # of that episode
    max_crossings: int = 4  # guard crossings in any second that are still no chatter

    NAME: ClassVar[str] = "modes"
    RANGES: ClassVar[dict[str, Range]] = {"max_crossings": (0, 1000)}

    def run(self) -> int:
        """Measures the automaton; returns 0 if no run shows chatter, else 1."""
        from diagrams.drawing.automaton import save_automaton

        home = self.loaded_world().initial_posture
        paths = find_records(self.records) or [self._run_episode()]
        runs = [mode_sequence(*load_record(path), path.stem, home) for path in paths]
        found = report(runs, self.max_crossings)
        self.write(found)
        save_automaton(found, self.out / "modes.png")
        print(
            f"{len(runs)} runs, {found['transitions']['task->return']} switches to the LQR; at most "
            f"{found['max_crossings_per_second']} crossings in a second (limit {self.max_crossings})"
        )
        for mode, dwell in found["dwell_seconds"].items():
            if dwell["count"]:
                print(f"dwell in {mode}: {dwell['min']:.1f} to {dwell['max']:.1f} s, median {dwell['median']:.1f} s")
        return 1 if found["zeno_like"] else 0

    def _run_episode(self) -> Path:
        """Path of the record of the episode that was run."""
        from tqdm import tqdm

        rollout, episode = self.closed_loop(self.disturbance)
        with tqdm(desc="run", unit="tick", leave=False, disable=None) as bar:
            outcome, record = rollout.run(episode, on_tick=lambda _: bar.update(), picture_every=PICTURE_EVERY)
        path = self.out / f"run-{rollout.policy.name}-{self.disturbance}-{self.seed}.npz"
        save_record(path, record, outcome)
        return path


@dataclass(frozen=True)
class Stay:
    """One stay in a mode: `start` and `end` in s; `complete`: both are guard crossings, not ends of the run."""

    mode: str
    start: float
    end: float
    complete: bool

    @property
    def seconds(self) -> float:
        """Dwell time, s."""
        return self.end - self.start


@dataclass(frozen=True)
class Reset:
    """What jumps where mode `return` ends: the network's posture input goes from imagined to measured."""

    time: float  # s
    joint_jump_deg: float  # largest difference of the two, joints
    finger_jump_m: float  # and fingers
    home_distance_deg: float  # of the arm's worst joint to the initial posture
    state_rms: float  # root mean square of the hidden state's components, which is 0 at c_0


@dataclass
class ModeSequence:
    """The modes of one run."""

    name: str
    outcome: str  # done, or the kind of failure
    disturbance: str
    modes: list[Stay]
    resets: list[Reset]

    @property
    def crossings(self) -> list[float]:
        """When the guard is crossed, s: each stay but the first begins so."""
        return [stay.start for stay in self.modes[1:]]

    @property
    def max_crossings_per_second(self) -> int:
        """Most guard crossings within any one second."""
        return most_within(self.crossings, 1.0)

    @property
    def shortest_stay(self) -> float:
        """Shortest dwell between two crossings, s; infinite without one."""
        return min((stay.seconds for stay in self.modes if stay.complete), default=float("inf"))


def most_within(times: list[float], span: float) -> int:
    """The most of `times` (s, ascending) in any half-open window [t, t + span)."""
    # Ticks are multiples of 0.1, which is not exact in binary.
    edges = np.searchsorted(times, np.asarray(times) + span - 1e-6) if times else np.array([0])
    return int(np.max(edges - np.arange(len(edges))))


def mode_sequence(record: Record, outcome: dict, name: str, initial_posture: np.ndarray) -> ModeSequence:
    """The modes of the run `name`, of its `record` and `outcome` (see Outcome); `initial_posture`: (8,) rad and m."""
    time, high = record.time.tolist(), record.alpha >= GUARD
    ticks, period = len(time), time[1] - time[0] if len(time) > 1 else 0.0
    crossed = (np.flatnonzero(np.diff(high)) + 1).tolist()
    ends = [*time, time[-1] + period]
    stays = [
        Stay(RETURN if high[a] else TASK, ends[a], ends[b], complete=a > 0 and b < ticks)
        for a, b in pairwise([0, *crossed, ticks])
    ]
    resets = [_reset(record, k, initial_posture) for k in crossed if not high[k]]
    result = "done" if outcome["success"] else str(outcome["failure"])
    return ModeSequence(name, result, outcome["disturbance"], stays, resets)


def _reset(record: Record, k: int, initial_posture: np.ndarray) -> Reset:
    # alpha falls at tick k: the network sees m_k. At alpha = 1 it would have seen m^R_k, predicted at the tick before.
    predicted = record.posture[k - 1] + record.rnn_step[k - 1] + record.regulator_step[k - 1]
    jump = np.abs(record.posture[k] - predicted)
    home = np.abs(record.posture[k] - initial_posture)[:ARM_JOINTS]
    return Reset(
        time=float(record.time[k]),
        joint_jump_deg=float(np.rad2deg(jump[:ARM_JOINTS].max())),
        finger_jump_m=float(jump[ARM_JOINTS:].max()),
        home_distance_deg=float(np.rad2deg(home.max())),
        state_rms=float(np.sqrt(np.mean(record.hidden_state[k - 1] ** 2))),
    )


def report(runs: list[ModeSequence], limit: int) -> dict:
    """The automaton measured on `runs`, as plain types; more crossings than `limit` in any second are chatter.

    `dwell_seconds` is over the stays that begin and end with a crossing, not those that an end of the run cuts off.
    """
    stays = [stay for run in runs for stay in run.modes if stay.complete]
    entered = Counter(stay.mode for run in runs for stay in run.modes[1:])
    nearest = sorted(runs, key=lambda run: (-run.max_crossings_per_second, run.shortest_stay))
    return {
        "runs": len(runs),
        "max_crossings_per_second": nearest[0].max_crossings_per_second,
        "limit_crossings_per_second": limit,
        "zeno_like": [run.name for run in runs if run.max_crossings_per_second > limit],
        "nearest": [
            {"name": run.name, "outcome": run.outcome, "crossings": len(run.crossings),
             "max_crossings_per_second": run.max_crossings_per_second, "shortest_stay_s": run.shortest_stay}
            for run in nearest[:5]
        ],
        "dwell_seconds": {m: _spread([stay.seconds for stay in stays if stay.mode == m]) for m in (TASK, RETURN)},
        "transitions": {f"{TASK}->{RETURN}": entered[RETURN], f"{RETURN}->{TASK}": entered[TASK]},
        "final_modes": {m: sum(run.modes[-1].mode == m for run in runs) for m in (TASK, RETURN)},
        "outcomes": dict(sorted(Counter(run.outcome for run in runs).items())),
        "resets": {
            name: _spread([getattr(reset, name) for run in runs for reset in run.resets])
            for name in ("joint_jump_deg", "finger_jump_m", "home_distance_deg", "state_rms")
        },
        "sequences": [asdict(run) for run in runs],
    }  # fmt: skip


def _spread(values: list[float]) -> dict:
    if not values:
        return {"count": 0}
    low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
    return {"count": len(values), "min": float(low), "median": float(middle), "max": float(high)}
