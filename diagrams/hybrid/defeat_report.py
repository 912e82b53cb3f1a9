"""What defeats have in common: counted, in words."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from diagrams.episodes.sampling import ONSET_LEVELS, STOP_TICKS
from diagrams.hybrid.defeat_cases import Case

LEVELS = ("near the goal", "midway", "far from the goal")
HOLDS, SIZES = ("short", "middling", "long"), ("small", "middling", "large")
CLUSTERS = 5  # that are told


def terciles(cases: Sequence[Case]) -> np.ndarray:
    """(2,) deg: between the thirds of the sizes by which `cases` of kind A were moved."""
    return np.quantile([case.moved_deg for case in cases] or [0.0], [1 / 3, 2 / 3])


def features(case: Case, sizes: np.ndarray) -> dict[str, str]:
    """What may be common to cases, in words; `sizes`: of `terciles`."""
    given = case.episode.disturbance
    assert given.level is not None
    low, high = ONSET_LEVELS[given.subtask]
    found = {
        "subtask": f"subtask {given.subtask}",
        "moment": f"begun {LEVELS[_third((given.level - low) / (high - low))]}",
        "way home": {True: "way home clear", False: "way home blocked", None: "way home unknown"}[
            case.episode.way_home_clear
        ],
        "vacant": f"{case.episode.vacant} spot vacant",
    }
    if given.kind == "A":
        return found | {"size": f"{SIZES[int(np.searchsorted(sizes, case.moved_deg))]} move"}
    share = (given.hold_ticks - STOP_TICKS[0]) / (STOP_TICKS[1] - STOP_TICKS[0])
    taken = "can taken" if given.can_moved_to is not None else "can left"
    return found | {"hold": f"{HOLDS[_third(share)]} stop", "can": taken}


def clusters(defeats: Sequence[Case], drawn: Sequence[Case]) -> dict[str, Any]:
    """Plain types: the commonest combinations of `defeats`, and what is commoner there than among all.

    `drawn`: cases drawn from the distribution itself. The defeats that moved copies found are not independent: counts
    say where they were found, the estimate says how probable they are.
    """
    sizes = terciles(drawn)
    of_defeats = [{"failure": case.failure or "", **features(case, sizes)} for case in defeats]
    of_drawn = [features(case, sizes) for case in drawn]
    combinations = Counter(tuple(found.values()) for found in of_defeats)
    first = {tuple(found.values()): i for i, found in reversed(list(enumerate(of_defeats)))}
    commonest = [
        {"words": ", ".join(words), "defeats": count, "example": first[words]}
        for words, count in combinations.most_common(CLUSTERS)
    ]
    shares = []
    for name in of_defeats[0] if of_defeats else ():
        [(value, count)] = Counter(found[name] for found in of_defeats).most_common(1)
        among = [found[name] == value for found in of_drawn if name in found]
        of_all = float(np.mean(among)) if among else None
        shares.append({"what": name, "value": value, "share": count / len(of_defeats), "share_of_all": of_all})
    return {"clusters": commonest, "common": shares}


def plain(case: Case) -> dict[str, Any]:
    """A counterexample in plain types."""
    given = case.episode.disturbance
    return {
        "kind": given.kind, "subtask": given.subtask, "level_m": given.level, "hold_ticks": given.hold_ticks,
        "can_moved_to": given.can_moved_to, "target": given.target, "moved_deg": case.moved_deg,
        "can": list(case.episode.can_xy), "vacant": case.episode.vacant,
        "way_home_clear": case.episode.way_home_clear, "failure": case.failure, "task_done": case.task_done,
        "record_hash": case.record_hash,
    }  # fmt: skip


def _third(share: float) -> int:
    """0, 1 or 2 of a share in [0, 1]."""
    return min(int(3 * share), 2)
