"""Two controllers compared while the episodes come in: evidence that may be looked at as often as one likes."""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from typing import Any

import numpy as np
from scipy.special import betaln

from diagrams.sweeps.task import Task

DECIDED = 20.0  # e at which two controllers are called different: of equal ones at most 1 in 20 ever are
PRIOR = 0.5  # a of the Beta distribution over the share: Jeffreys'


def evidence(wins: int | np.ndarray, discordant: int | np.ndarray, prior: float = PRIOR) -> np.ndarray:
    """e = 2^m B(a + k, a + m - k) / B(a, a) of k `wins` in m `discordant` pairs: where the two did not do the same.

    The likelihood of the sequence under a share drawn from Beta(a, a) over that of a fair coin. Of a fair coin its mean
    is 1 after every pair, given the past: so with equal controllers e exceeds c at any time with a probability of at
    most 1 / c (Ville's inequality; Grünwald, de Heide and Koolen, Safe testing, J. R. Stat. Soc. B 86, 2024), however
    often one looks and whenever one stops. Arrays, or a number each; may be inf. Raises ValueError unless
    0 <= wins <= discordant and prior > 0.
    """
    k, m = np.asarray(wins, float), np.asarray(discordant, float)
    if not (np.all(k >= 0) and np.all(k <= m)) or not prior > 0.0:
        raise ValueError(f"wins {wins} of discordant {discordant} pairs, prior {prior}: 0 <= wins <= discordant needed")
    with np.errstate(over="ignore"):
        return np.exp(m * np.log(2.0) + betaln(prior + k, prior + m - k) - betaln(prior, prior))[()]


def scenes_won(differences: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """In how many scenes the first of two controllers did more, and in how many they did not do the same.

    `differences`: scene, and the tasks done by the first less those by the second, of one run or of all; a scene has as
    many as it likes, of several training seeds or faults: their sum counts.
    """
    more: dict[int, int] = {}
    for scene, difference in differences:
        more[scene] = more.get(scene, 0) + difference
    return sum(d > 0 for d in more.values()), sum(d != 0 for d in more.values())


def paired(differences: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """What a comparison of a with b says of these `differences` (see `scenes_won`), for a JSON file.

    `n` pairs of runs, of which `only_a` or `only_b` did the task; `scenes`, `scenes_a` and `scenes_b` of which went to
    one of the two; their `e`, the largest float where it is beyond, since JSON has no infinity.
    """
    wins, discordant = scenes_won(differences)
    return {
        "n": len(differences),
        "only_a": sum(difference > 0 for _, difference in differences),
        "only_b": sum(difference < 0 for _, difference in differences),
        "scenes": len({scene for scene, _ in differences}),
        "scenes_a": wins,
        "scenes_b": discordant - wins,
        "e": min(float(evidence(wins, discordant)), sys.float_info.max),
    }


def evidence_of(tasks: Sequence[Task], rows: Mapping[str, dict[str, Any]]) -> float:
    """e of the tasks done by the two controllers of `tasks`, of which `rows` has some; a scene is a pair.

    Over the training seeds of a scene: which of the two did more of them.
    """
    first, one = (tasks[0].rnn, tasks[0].detector), dict[tuple[int, int], int]()
    both = list[tuple[int, int]]()
    for task in tasks:
        success = rows.get(task.key, {}).get("success")
        if success is None:
            continue
        pair, sign = (task.seed, task.training_seed), 1 if (task.rnn, task.detector) == first else -1
        if pair in one:
            both.append((task.seed, one[pair] + sign * int(success)))
        else:
            one[pair] = sign * int(success)
    return float(evidence(*scenes_won(both)))


def decided(tasks: Sequence[Task], rows: Mapping[str, dict[str, Any]]) -> dict[str, float]:
    """What disturbs, see Task, where the comparison is decided by the `rows` (by key) that `tasks` have; and its e."""
    kinds = dict.fromkeys(task.disturbed_by for task in tasks)
    found = {kind: evidence_of([task for task in tasks if task.disturbed_by == kind], rows) for kind in kinds}
    return {kind: e for kind, e in found.items() if e >= DECIDED}


def rounds(tasks: Sequence[Task], rows: Mapping[str, dict[str, Any]], left: Set[str]) -> Iterator[list[Task]]:
    """Those of `tasks` whose keys are in `left`, scene after scene; nothing more of a disturbance that is `decided`.

    `rows`: the caller adds to it between two rounds.
    """
    for seed in dict.fromkeys(task.seed for task in tasks):
        over = decided(tasks, rows)
        yield [t for t in tasks if t.seed == seed and t.disturbed_by not in over and t.key in left]
