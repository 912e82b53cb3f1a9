"""What starts at home, and disturbed runs, say about the region of resumption: counts, each with its bound."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from diagrams.episodes.switching import RESUME_SECONDS
from diagrams.hybrid.return_proof import bound

PATIENCE = 2.0  # starts are followed for so many times RESUME_SECONDS


@dataclass(frozen=True)
class Row:
    """What came of a start."""

    scene: int  # seed of its episode
    rule: str  # of RESUMPTIONS
    kind: str  # of KINDS
    left: int  # ticks of its subtask that the network had still to imagine
    foretold: int | None  # T; None: more than the ticks that are followed
    resumed: int | None  # ticks; None: as above
    done: bool | None  # the subtask; None: not looked at, or not resumed


@dataclass(frozen=True)
class RunRow:
    """What came of a disturbed run."""

    came_home: bool  # as the switching asks for
    foretold: int | None = None  # T at the first tick at home
    resumed: int | None = None  # ticks from there

    @classmethod
    def none(cls) -> Self:
        """Of a run whose arm did not come home, or that was not disturbed."""
        return cls(False)


def followed_ticks(period: float) -> int:
    """For how long a start is followed, ticks; `period`: of the ticks, s."""
    return round(PATIENCE * RESUME_SECONDS / period)


def judge(rows: Sequence[Row], period: float) -> dict[str, Any]:
    """The report of the starts of one kind and rule, plain types; `period`: of the ticks, s."""
    limit = round(RESUME_SECONDS / period)
    followed = followed_ticks(period) + 1  # stands for None
    predicted = np.array([followed if row.foretold is None else row.foretold for row in rows], int)
    measured = np.array([followed if row.resumed is None else row.resumed for row in rows], int)
    failed, foretold = measured > limit, predicted > limit
    # The largest level below all starts that failed.
    lowest = int(predicted[failed].min()) if failed.any() else followed
    inside = predicted <= min(limit, lowest - 1)
    seconds = measured[~failed] * period
    done = [row.done for row in rows if row.done is not None]
    off, left = np.abs(predicted - measured), np.array([row.left for row in rows])
    both = (predicted < followed) & (measured < followed)
    return {
        "samples": len(rows),
        "not_resumed": int(failed.sum()),
        "bound": bound(int(failed.sum()), len(rows)),
        "scenes": by_scene(rows, period),
        "foretold": int(foretold.sum()),
        "foretold_wrongly": int((foretold != failed).sum()),
        "largest_error_ticks": int(off[both].max(initial=0)),
        "level_ticks": int(predicted[inside].max()) if inside.any() else None,
        "inside": int(inside.sum()),
        "inside_bound": bound(0, int(inside.sum())) if inside.any() else 1.0,
        "left_to_imagine_s": {
            "resumed": float(np.median(left[~failed]) * period) if (~failed).any() else None,
            "not_resumed": float(np.median(left[failed]) * period) if failed.any() else None,
        },
        "time_s": {
            "median": float(np.median(seconds)), "p95": float(np.quantile(seconds, 0.95)), "max": float(seconds.max()),
        } if len(seconds) else None,
        "finished": {
            "samples": len(done), "failures": len(done) - sum(done), "bound": bound(len(done) - sum(done), len(done)),
        } if done else None,
    }  # fmt: skip


def by_scene(rows: Sequence[Row], period: float) -> dict[str, Any]:
    """Scenes, and how many have a start that does not resume in time; plain types.

    Starts of one scene share its picture: the bound of scenes asks no more than that scenes are independent.
    """
    limit, n = round(RESUME_SECONDS / period), len({row.scene for row in rows})
    lost = len({row.scene for row in rows if row.resumed is None or row.resumed > limit})
    return {"samples": n, "failures": lost, "bound": bound(lost, n)}


def finished_by_scene(rows: Sequence[Row]) -> dict[str, Any] | None:
    """Scenes with a subtask that was looked at, and how many have one that is not done; plain types, None of none."""
    seen = {row.scene for row in rows if row.done is not None}
    lost = {row.scene for row in rows if row.done is False}
    return {"samples": len(seen), "failures": len(lost), "bound": bound(len(lost), len(seen))} if seen else None


def judge_runs(rows: Sequence[RunRow], period: float) -> dict[str, Any]:
    """The report of the disturbed runs, plain types; `period`: of the ticks, s."""
    limit, home = round(RESUME_SECONDS / period), [row for row in rows if row.came_home]
    foretold = [row.foretold is None or row.foretold > limit for row in home]
    failed = [row.resumed is None or row.resumed > limit for row in home]
    off = [abs(row.foretold - row.resumed) for row in home if row.foretold is not None and row.resumed is not None]
    return {
        "samples": len(rows),
        "came_home": len(home),
        "foretold": sum(foretold),
        "not_resumed": sum(failed),
        "foretold_wrongly": sum(a != b for a, b in zip(foretold, failed, strict=True)),
        "largest_error_ticks": max(off, default=0),
        "bound": bound(sum(failed), len(home)) if home else 1.0,
    }


def words(rule: str, kind: str, found: dict[str, Any]) -> str:
    """The report of a rule and a kind of starts, in words."""
    time, done = found["time_s"], found["finished"]
    text = (
        f"{rule}, {kind}: {found['not_resumed']} of {found['samples']} starts do not resume within "
        f"{RESUME_SECONDS:g} s (95 % bound {found['bound']:.1e}), {found['foretold']} were foretold, "
        f"{found['foretold_wrongly']} wrongly; all {found['inside']} with T up to {found['level_ticks']} ticks resume"
    )
    if time is not None:
        text += f"; after {time['median']:.1f} s (median), {time['max']:.1f} s at most"
    if done is not None:
        text += f"; {done['failures']} of {done['samples']} subtasks not done"
    return text


def words_of_runs(found: dict[str, Any]) -> str:
    """The report of the disturbed runs, in words."""
    return (
        f"{found['came_home']} of {found['samples']} disturbed runs come home, {found['not_resumed']} of these do not "
        f"resume within {RESUME_SECONDS:g} s (95 % bound {found['bound']:.1e}), {found['foretold']} were foretold, "
        f"{found['foretold_wrongly']} wrongly; T is off by {found['largest_error_ticks']} ticks at most"
    )
