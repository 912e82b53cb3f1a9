"""What a detector learns from: a run without a fault, as the detector's ports had it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# What the `fit` of a detector is given, by its attribute `learns_from`:
#   postures: runs (T_i, J), rad, of the demonstrations; one fit for every network.
#   network: runs that a network made, NormalRun; one fit for each network.
#   policies: the contents of the files of the networks that it is fitted for, bytes; one fit for all of them.
#   nothing: no run; `fit` returns {}.
SOURCES = ("postures", "network", "policies", "nothing")


@dataclass(frozen=True)
class NormalRun:
    """A row a tick: what the ports of systems/detector.py had at tick k, scaled as there; no alarm, no fault.

    Attributes:
        posture: (T, M) m_k.
        recalled_postures: (T, N + 1, M), row 0 is m^R_k, predicted, row n is m^R_{k-1-n}, recalled.
        hidden_state: (T, S) c_{k-1}.
        features: (T, F) f_k.
        predicted_features: (T, F) f^R_k; the first row is 0, nothing was predicted.
    """

    posture: np.ndarray
    recalled_postures: np.ndarray
    hidden_state: np.ndarray
    features: np.ndarray
    predicted_features: np.ndarray


def rows_of(runs: Sequence[NormalRun], *names: str) -> np.ndarray:
    """(sum T_i, D) what the ports `names` had, side by side, run after run."""
    parts = [[getattr(run, name).reshape(len(run.posture), -1) for name in names] for run in runs]
    return np.vstack([np.hstack(part) for part in parts])


def fitted_for(policy_hash: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """`arrays`, of a `fit` for one network, under the names that they have in a file with those of other networks."""
    return {f"{policy_hash}/{name}": array for name, array in arrays.items()}


def of_policy(policy_hash: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a file that are for that network: its own, see `fitted_for`, and those for all."""
    found = {name.removeprefix(f"{policy_hash}/"): array for name, array in arrays.items()}
    return {name: array for name, array in found.items() if "/" not in name}
