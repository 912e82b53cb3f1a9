"""Files of the detectors that learn from runs: what was learned, and a calibration for each policy."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from models.files.container import WeightsError
from models.files.tensors import read_tensors, write_tensors

_REMEDY = "Make it with `python diagrams/baselines.py`"


@dataclass
class StoredDetector:
    """What a detector's file holds.

    Attributes:
        detector: its spec in systems.detectors.DETECTORS.
        arrays: what its class learned from runs, by name; as stored, dtypes included.
        calibrations: by the hash of the policy's file: mean_errors (one a criterion), beta, gamma.
        metadata: anything else, JSON-serialisable.
    """

    detector: str
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    calibrations: dict[str, dict[str, Any]] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict)


def save_detector(path: str | Path, stored: StoredDetector) -> None:
    """Writes the file in one go."""
    header = {"calibrations": stored.calibrations, "metadata": stored.metadata}
    write_tensors(path, stored.arrays, {"kind": "detector", "method": stored.detector} | header)


def load_detector(path: str | Path, detector: str) -> StoredDetector:
    """Reads what save_detector wrote; raises WeightsError unless it is a whole file of that detector."""
    arrays, header = read_tensors(path, "detector", _REMEDY)
    if header.get("method") != detector:
        raise WeightsError(path, f"holds the detector {header.get('method')!r}, not {detector!r}", _REMEDY)
    if absent := {"calibrations", "metadata"} - set(header):
        raise WeightsError(path, f"has no {' and no '.join(sorted(absent))} in its header", _REMEDY)
    for name in ("calibrations", "metadata"):
        if not isinstance(header[name], dict):
            raise WeightsError(path, f"has the {name} {header[name]!s:.60} in its header, no map", _REMEDY)
    return StoredDetector(detector, arrays, header["calibrations"], header["metadata"])


def calibration_of(
    path: str | Path, stored: StoredDetector, policy_hash: str, by: str = "baselines.py"
) -> dict[str, Any]:
    """The calibration for the policy with that file hash; raises WeightsError if there is none, or not a whole one.

    `by`: the program of diagrams/ that makes it, for the remedy.
    """
    calibrations, short, remedy = stored.calibrations, policy_hash[:12], f"Make it with `python diagrams/{by}`"
    found = calibrations.get(policy_hash) if isinstance(calibrations, dict) else None
    if not isinstance(found, dict):
        raise WeightsError(path, f"has no calibration for the policy whose file has the hash {short}", remedy)
    if absent := {"mean_errors", "beta", "gamma"} - set(found):
        raise WeightsError(path, f"has a calibration without {' and '.join(sorted(absent))} for {short}", remedy)
    for name, axes, lowest in (("mean_errors", 1, 0.0), ("beta", 0, 0.0), ("gamma", 0, 0.0)):
        try:
            value = np.asarray(found[name])
            value = value.astype(float) if value.dtype.kind in "iuf" else np.array([np.nan])
        except ValueError:  # a list of lists of several lengths
            value = np.array([np.nan])
        if value.ndim != axes or not value.size or not np.all((value > lowest) & (value < np.inf)):
            wanted = f"{'finite numbers' if axes else 'a finite number'}{'' if lowest else ' above 0'}"
            raise WeightsError(path, f"has the {name} {found[name]!s:.60} for {short}, not {wanted}", remedy)
    return found
