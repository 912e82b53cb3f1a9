"""What a detector learns from: runs as its ports had them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import InputError

# What the `fit` of a detector is given, by its attribute `learns_from`:
#   postures: runs (T_i, J), rad, of the demonstrations; one fit for every network.
#   network: tapes of runs that a network made, without a fault; one fit for each network.
#   policies: the contents of the files of the networks that it is fitted for, bytes; one fit for all of them.
#   nothing: no run; `fit` returns {}.
SOURCES = ("postures", "network", "policies", "nothing")


@dataclass(frozen=True)
class Tape:
    """A run, a row a tick: what the ports of systems/detector.py had at tick k, as they have it there.

    Attributes:
        posture: (T, M) m_k, scaled.
        recalled_postures: (T, N + 1, M), scaled; row 0 is m^R_k, predicted, row n is m^R_{k-1-n}, recalled.
        hidden_state: (T, S) c_{k-1}.
        features: (T, F) f_k.
        predicted_features: (T, F) f^R_k; the first row is 0, nothing was predicted.
        active: (T,) 1 while the arm is known to be disturbed.
    """

    posture: np.ndarray
    recalled_postures: np.ndarray
    hidden_state: np.ndarray
    features: np.ndarray
    predicted_features: np.ndarray
    active: np.ndarray


def rows_of(runs: Sequence[Tape], *names: str) -> np.ndarray:
    """(sum T_i, D) what the ports `names` had, side by side, run after run."""
    parts = [[getattr(run, name).reshape(len(run.posture), -1) for name in names] for run in runs]
    return np.vstack([np.hstack(part) for part in parts])


def learned(detector: Any, runs: list[Any]) -> dict[str, np.ndarray]:
    """What the class `detector` learns from `runs`: its `fit`; raises InputError unless that is arrays by name."""
    found = detector.fit(runs)
    if not isinstance(found, Mapping) or not all(
        isinstance(name, str) and isinstance(array, np.ndarray) and array.dtype.kind in "biuf"
        for name, array in found.items()
    ):
        raise InputError(
            f"{detector.__name__}.fit returns {found!r:.60}: it must return arrays of numbers by name, or {{}} where "
            "nothing is learned"
        )
    return dict(found)


def fitted_for(policy_hash: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """`arrays`, of a `fit` for one network, under the names that they have in a file with those of other networks."""
    return {f"{policy_hash}/{name}": array for name, array in arrays.items()}


def of_policy(policy_hash: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a file that are for that network: its own, see `fitted_for`, and those for all."""
    found = {name.removeprefix(f"{policy_hash}/"): array for name, array in arrays.items()}
    return {name: array for name, array in found.items() if "/" not in name}
