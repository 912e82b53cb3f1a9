"""The switched loop as a hybrid automaton: its modes, guard crossings, dwell times and resets, measured on recorded runs.

Mode `task` (alpha < 1/2): the network moves the arm and sees it. Mode `return` (alpha >= 1/2): the LQR moves the arm, the network runs on its
own predictions. The guard is alpha = 1/2. Crossing it back resets the network's input from what it imagined to what is measured: at the
switching point the two should be the same. It does so a tick later, since Eqs. 7 and 8 take alpha of the tick before; for that tick the joints are
still left to the LQR, and for a few more the fingers stand (AlphaMixer).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD as GUARD
from diagrams.world.names import ARM_JOINTS

TASK, RETURN = "task", "return"
SHORT = 0.3  # s: a stay up to that is listed by where it comes
AT_RESET = 2.0  # s before the last crossing back in which a short stay belongs to it


@dataclass(frozen=True)
class Stay:
    """One stay in a mode: `start` and `end` in s; `complete` where both ends are guard crossings, not ends of the run."""

    mode: str
    start: float
    end: float
    complete: bool

    @property
    def seconds(self) -> float:
        """Dwell time, s."""
        return self.end - self.start


@dataclass(frozen=True)
class Crossing:
    """The guard crossed at tick `tick`, at `time` (s): the values of alpha of the tick before and of this one."""

    tick: int
    time: float
    source: str
    target: str
    alpha_before: float
    alpha_after: float


@dataclass(frozen=True)
class Reset:
    """What jumps where mode `return` ends: the network's posture input goes from imagined to measured.

    `joint_jump_deg`, `finger_jump_m`: largest difference of the two; `home_distance_deg`: of the arm's worst joint to the initial posture;
    `state_rms`: root mean square of the hidden state's components, which is 0 at c_0.
    """

    time: float
    joint_jump_deg: float
    finger_jump_m: float
    home_distance_deg: float
    state_rms: float


@dataclass
class ModeSequence:
    """The modes of one run."""

    name: str
    outcome: str  # done, or the kind of failure
    disturbance: str
    stays: list[Stay]
    crossings: list[Crossing]
    resets: list[Reset] = field(default_factory=list)

    @property
    def max_crossings_per_second(self) -> int:
        """Most guard crossings within any one second."""
        return most_within([c.time for c in self.crossings], 1.0)

    @property
    def shortest_stay(self) -> float:
        """Shortest dwell between two crossings, s; infinite without one."""
        return min((stay.seconds for stay in self.stays if stay.complete), default=float("inf"))


def most_within(times: list[float], span: float) -> int:
    """The most of `times` (s, ascending) in any half-open window [t, t + span)."""
    # Ticks are multiples of 0.1, which is not exact in binary.
    edges = np.searchsorted(times, np.asarray(times) + span - 1e-6) if times else np.array([0])
    return int(np.max(edges - np.arange(len(edges))))


def mode_sequence(record: Record, outcome: dict, name: str, initial_posture: np.ndarray) -> ModeSequence:
    """The modes of the run `record` with the `outcome` that goes with it (see Outcome).

    Args:
        name: of the run, for the report.
        initial_posture: (8,) rad and m.
    """
    time, alpha = record.time, record.alpha
    period = float(time[1] - time[0]) if len(time) > 1 else 0.0
    high = alpha >= GUARD
    changes = np.flatnonzero(np.diff(high.astype(int))) + 1
    names = [RETURN if h else TASK for h in high]
    edges = [0, *changes.tolist(), len(time)]
    ends = [*time.tolist(), float(time[-1]) + period]
    stays = [Stay(names[a], ends[a], ends[b], complete=a > 0 and b < len(time)) for a, b in pairwise(edges)]
    crossings = [
        Crossing(int(k), float(time[k]), names[k - 1], names[k], float(alpha[k - 1]), float(alpha[k])) for k in changes
    ]
    resets = [_reset(record, int(k), initial_posture) for k in changes if not high[k] and k + 1 < len(time)]
    result = "done" if outcome["success"] else str(outcome["failure"])
    return ModeSequence(name, result, outcome["disturbance"], stays, crossings, resets)


def _reset(record: Record, k: int, initial_posture: np.ndarray) -> Reset:
    # alpha falls at tick k, whose input is still imagined. The next would be the prediction made at k: dm^R is taken from the posture of k.
    jump = np.abs(record.posture[k + 1] - (record.posture[k] + record.rnn_step[k]))
    home = np.abs(record.posture[k + 1] - initial_posture)[:ARM_JOINTS]
    return Reset(
        time=float(record.time[k + 1]),
        joint_jump_deg=float(np.rad2deg(jump[:ARM_JOINTS].max())),
        finger_jump_m=float(jump[ARM_JOINTS:].max()),
        home_distance_deg=float(np.rad2deg(home.max())),
        state_rms=float(np.sqrt(np.mean(record.hidden_state[k] ** 2))),
    )


def _spread(values: list[float]) -> dict:
    if not values:
        return {"count": 0}
    low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
    return {"count": len(values), "min": float(low), "median": float(middle), "max": float(high)}


def short_stays(runs: list[ModeSequence]) -> dict[str, int]:
    """How many stays between two crossings last at most SHORT, by where they come.

    `reset`: within AT_RESET before the run's last crossing back to `task`, or in `task` right after it; `onset`: the first stay in `return`, or
    within AT_RESET of the first crossing; `between`: any other.
    """
    found = {"onset": 0, "reset": 0, "between": 0}
    for run in runs:
        back = [c.time for c in run.crossings if c.target == TASK]
        for stay in run.stays:
            if not stay.complete or stay.seconds > SHORT + 1e-9:
                continue
            if stay.start - run.crossings[0].time < AT_RESET:
                found["onset"] += 1
            elif back and -AT_RESET <= stay.start - back[-1] <= 1e-9:
                found["reset"] += 1
            else:
                found["between"] += 1
    return found


def report(runs: list[ModeSequence], limit: int) -> dict:
    """The automaton measured on `runs`, as plain types.

    `limit`: more crossings than this in any second are chatter. `dwell_seconds` is over stays that begin and end with a crossing; the ones that
    the run's start or end cuts off are in `cut_off_seconds`.
    """
    stays = [stay for run in runs for stay in run.stays]
    transitions = {f"{a}->{b}": 0 for a, b in ((TASK, RETURN), (RETURN, TASK))}
    for run in runs:
        for crossing in run.crossings:
            transitions[f"{crossing.source}->{crossing.target}"] += 1
    nearest = sorted(runs, key=lambda run: (-run.max_crossings_per_second, run.shortest_stay))
    most = max(run.max_crossings_per_second for run in runs)

    def dwell(complete: bool) -> dict:
        return {
            m: _spread([s.seconds for s in stays if s.mode == m and s.complete is complete]) for m in (TASK, RETURN)
        }

    return {
        "runs": len(runs),
        "max_crossings_per_second": most,
        "limit_crossings_per_second": limit,
        "zeno_like": [run.name for run in runs if run.max_crossings_per_second > limit],
        "nearest": [
            {
                "name": run.name,
                "max_crossings_per_second": run.max_crossings_per_second,
                "shortest_stay_s": run.shortest_stay if np.isfinite(run.shortest_stay) else None,
                "crossings": len(run.crossings),
                "outcome": run.outcome,
            }
            for run in nearest[:5]
        ],
        "dwell_seconds": dwell(True),
        "cut_off_seconds": dwell(False),
        "short_stays": {"up_to_seconds": SHORT} | short_stays(runs),
        "transitions": transitions,
        "final_modes": {m: sum(run.stays[-1].mode == m for run in runs) for m in (TASK, RETURN)},
        "outcomes": {o: sum(run.outcome == o for run in runs) for o in sorted({run.outcome for run in runs})},
        "resets": {
            name: _spread([getattr(reset, name) for run in runs for reset in run.resets])
            for name in ("joint_jump_deg", "finger_jump_m", "home_distance_deg", "state_rms")
        },
        "sequences": [
            {
                "name": run.name,
                "disturbance": run.disturbance,
                "outcome": run.outcome,
                "modes": [asdict(stay) for stay in run.stays],
                "crossings": [asdict(crossing) for crossing in run.crossings],
                "resets": [asdict(reset) for reset in run.resets],
            }
            for run in runs
        ],
    }


def save_automaton(runs: list[ModeSequence], path: Path) -> None:
    """Draws the automaton with measured counts and dwell times (left) and every run's modes over time (right)."""
    from diagrams.drawing.style import BLUE, RED, new_figure, save

    found = report(runs, limit=0)
    figure, (left, right) = new_figure(1, 2, figsize=(13, 5.2), width_ratios=(1, 1.25))
    left.set_xlim(-2.6, 2.6)
    left.set_ylim(-1.75, 1.75)
    left.set_aspect("equal")
    left.axis("off")
    for x, mode, law, colour in ((-1.5, TASK, r"$\alpha<1/2$", BLUE), (1.5, RETURN, r"$\alpha\geq 1/2$", RED)):
        left.add_patch(_disc(x, colour))
        dwell = found["dwell_seconds"][mode]
        words = [rf"$\bf{{{mode}}}$", law]
        if dwell["count"]:
            words += [f"{dwell['min']:.1f} / {dwell['median']:.1f} / {dwell['max']:.1f} s", f"stays: {dwell['count']}"]
        left.text(x, 0.0, "\n".join(words), ha="center", va="center", fontsize=9)
    arrow = {"arrowstyle": "-|>", "lw": 1.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 16}
    for x, y, sign, key, text in (
        (-0.95, 0.55, 1, f"{TASK}->{RETURN}", "recall fails\nLQR alone; network imagines"),
        (0.95, -0.55, -1, f"{RETURN}->{TASK}", "recalls again at the switching point\nreset: input := measured"),
    ):
        left.annotate("", (-x, y), (x, y), arrowprops={**arrow, "connectionstyle": "arc3,rad=-0.35", "color": "0.2"})
        left.text(
            0, y + sign * 0.62, f"{found['transitions'][key]} times: {text}", ha="center", va="center", fontsize=8
        )
    left.annotate("", (-2.3, 0.0), (-2.6, 0.0), arrowprops={**arrow, "color": "0.2"})
    left.set_title(f"runs: {len(runs)}; dwell times: shortest / median / longest between two crossings", fontsize=9)
    for row, run in enumerate(runs):
        for stay in run.stays:
            right.barh(row, stay.seconds, left=stay.start, height=0.8, color=BLUE if stay.mode == TASK else RED, lw=0)
    right.set_ylim(len(runs) - 0.4, -0.6)
    right.set_xlabel("time (s)")
    step = max(1, len(runs) // 30)
    right.set_yticks(range(0, len(runs), step), [f"{r.name} ({r.outcome})" for r in runs[::step]], fontsize=6)
    right.set_title(f"modes over time; at most {found['max_crossings_per_second']} crossings in a second", fontsize=9)
    save(figure, path)


def _disc(x: float, colour: str):
    from matplotlib.patches import Circle

    return Circle((x, 0.0), 0.8, facecolor=colour, alpha=0.18, edgecolor=colour, lw=2)
