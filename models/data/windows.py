"""Windows of joint angles and what the two baselines learn from them (Sec. IV-B)."""

from collections.abc import Mapping, Sequence

import numpy as np

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

    svd = TruncatedSVD(AXES, algorithm="arpack", random_state=0)
    still = np.linalg.qr(np.vander(np.arange(windows.shape[2]), AXES, increasing=True))[0]  # constant and ramp
    # ARPACK raises for a joint that stays at 0.
    return np.array([svd.fit(rows).components_.T if np.ptp(rows) else still for rows in windows], np.float32)


def encode_runs(runs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Runs (T_i, J) in rad as a file keeps them: angles (sum T_i, J) int16 of 1e-4 rad, and the runs' lengths, int32.

    Where 16 bits do not hold that (another arm's joints, or degrees), `unit` (1,) is the least larger one that they do.
    """
    values, limit = np.concatenate(runs), np.iinfo(np.int16).max
    unit = max(_UNIT, float(np.abs(values).max()) / limit)
    lengths = np.array([len(run) for run in runs], np.int32)
    arrays: dict[str, np.ndarray] = {"angles": np.round(values / unit).astype(np.int16), "lengths": lengths}
    return arrays if unit == _UNIT else arrays | {"unit": np.array([unit])}


def decode_runs(arrays: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """The runs (T_i, J) in rad that encode_runs rounded: what is evaluated is what was stored."""
    unit = arrays.get("unit", np.array([_UNIT]))
    return np.split(unit * arrays["angles"].astype(float), np.cumsum(arrays["lengths"])[:-1])
