"""Windows of joint angles and what the two baselines learn from them (Sec. IV-B)."""

from collections.abc import Mapping, Sequence

import numpy as np

from models.errors import InputError

WINDOW = 10  # samples
AXES = 2
_UNIT = 1e-4  # rad: the angles are stored as 16-bit multiples of it


def posture_windows(runs: Sequence[np.ndarray], window: int = WINDOW) -> np.ndarray:
    """All windows (J, n, window) of runs (T_i, J), each no shorter than a window; the newest sample first."""
    parts = [np.lib.stride_tricks.sliding_window_view(run, window, axis=0)[..., ::-1] for run in runs]
    return np.ascontiguousarray(np.concatenate(parts).swapaxes(0, 1))


def leading_axes(windows: np.ndarray) -> np.ndarray:
    """The first left singular vectors of each joint's windows, not centred, (J, n, w) to columns (J, w, 2) float32."""
    from sklearn.decomposition import TruncatedSVD

    axes = [TruncatedSVD(AXES, algorithm="arpack", random_state=0).fit(rows).components_.T for rows in windows]
    return np.array(axes, np.float32)


def encode_runs(runs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Runs (T_i, J) in rad as a file keeps them: angles (sum T_i, J) int16 of 1e-4 rad, and the runs' lengths, int32.

    Raises InputError for an angle beyond what 16 bits hold.
    """
    counts, limit = np.round(np.concatenate(runs) / _UNIT), np.iinfo(np.int16).max
    if np.abs(counts).max() > limit:
        raise InputError(
            f"an angle of {np.abs(counts).max() * _UNIT:.2f} rad cannot be stored; "
            f"the limit is {limit * _UNIT:.2f} rad: take runs within it"
        )
    return {"angles": counts.astype(np.int16), "lengths": np.array([len(run) for run in runs], np.int32)}


def decode_runs(arrays: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """The runs (T_i, J) in rad that encode_runs rounded: what is evaluated is what was stored."""
    return np.split(_UNIT * arrays["angles"].astype(float), np.cumsum(arrays["lengths"])[:-1])
