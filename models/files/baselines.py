"""Windows of joint angles, what the two baselines learn from them (Sec. IV-B), and the files that keep it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from models.files.weights import WeightsError, read_tensors, write_tensors

WINDOW = 10  # samples
AXES = 2
METHODS = ("knn", "subspace")
_UNIT = 1e-4  # rad: the angles are stored as 16-bit multiples of it
_REMEDY = "Make it with `python diagrams/baselines.py`"


def posture_windows(runs: Sequence[np.ndarray], window: int = WINDOW) -> np.ndarray:
    """All windows of each run, (J, n, window), the newest sample first; `runs`: (T_i, J) each, no shorter than a window."""
    parts = [np.lib.stride_tricks.sliding_window_view(run, window, axis=0)[..., ::-1] for run in runs]
    return np.ascontiguousarray(np.concatenate(parts).swapaxes(0, 1))


def leading_axes(windows: np.ndarray) -> np.ndarray:
    """The two first left singular vectors of each joint's windows as columns; (J, n, w) -> (J, w, 2), nothing subtracted."""
    from sklearn.decomposition import TruncatedSVD

    axes = [TruncatedSVD(AXES, algorithm="arpack", random_state=0).fit(rows).components_.T for rows in windows]
    return np.array(axes)


@dataclass
class StoredDetector:
    """What a baseline's file holds; angles rad.

    Attributes:
        method: "knn" or "subspace".
        runs: training runs (T_i, J) whose windows are the neighbours; empty for the subspace method.
        axes: (J, w, 2), None for kNN.
        calibrations: by the hash of the policy's file: mean_errors (J,), beta, gamma.
        metadata: anything else, JSON-serialisable.
    """

    method: str
    runs: list[np.ndarray] = field(default_factory=list)
    axes: np.ndarray | None = None
    calibrations: dict[str, dict[str, Any]] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)


def stored_as(runs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The runs as a file gives them back: what is evaluated is what was stored."""
    return [_UNIT * np.round(run / _UNIT) for run in runs]


def save_detector(path: str | Path, detector: StoredDetector) -> None:
    """Writes the file; raises ValueError for angles beyond what 16 bits hold (3.2 rad)."""
    if detector.axes is not None:
        tensors = {"axes": torch.from_numpy(np.asarray(detector.axes, np.float32))}
    else:
        counts = np.round(np.concatenate(detector.runs) / _UNIT)
        if np.abs(counts).max() > np.iinfo(np.int16).max:
            raise ValueError(
                f"an angle of {np.abs(counts).max() * _UNIT:.2f} rad cannot be stored; the limit is 3.27 rad"
            )
        lengths = torch.tensor([len(run) for run in detector.runs], dtype=torch.int32)
        tensors = {"angles": torch.from_numpy(counts.astype(np.int16)), "lengths": lengths}
    header = {
        "kind": "detector",
        "method": detector.method,
        "calibrations": detector.calibrations,
        "metadata": detector.metadata,
    }
    write_tensors(path, tensors, header)


def load_detector(path: str | Path, method: str) -> StoredDetector:
    """Reads what save_detector wrote; raises WeightsError unless it is a whole file of that method."""
    tensors, header = read_tensors(path, "detector")
    if header.get("method") != method:
        raise WeightsError(path, f"holds the method {header.get('method')!r}, not {method!r}", _REMEDY)
    wanted = {"axes"} if method == "subspace" else {"angles", "lengths"}
    if set(tensors) != wanted:
        raise WeightsError(path, f"holds {sorted(tensors)}, where {sorted(wanted)} are needed", _REMEDY)
    absent = {"calibrations", "metadata"} - set(header)
    if absent:
        raise WeightsError(path, f"has no {' and no '.join(sorted(absent))} in its header", _REMEDY)
    detector = StoredDetector(method, calibrations=header["calibrations"], metadata=header["metadata"])
    if method == "subspace":
        detector.axes = tensors["axes"].double().numpy()
    else:
        angles = _UNIT * tensors["angles"].double().numpy()
        detector.runs = np.split(angles, np.cumsum(tensors["lengths"].numpy())[:-1])
    return detector


def calibration_of(path: str | Path, detector: StoredDetector, policy_hash: str) -> dict[str, Any]:
    """The calibration for the policy with that file hash; raises WeightsError if there is none."""
    if policy_hash not in detector.calibrations:
        raise WeightsError(
            path, f"has no calibration for the policy whose file has the hash {policy_hash[:12]}", _REMEDY
        )
    found = detector.calibrations[policy_hash]
    absent = {"mean_errors", "beta", "gamma"} - set(found)
    if absent:
        raise WeightsError(
            path, f"has a calibration without {' and '.join(sorted(absent))} for {policy_hash[:12]}", _REMEDY
        )
    return found
