"""Which controller: the policy's file, its detector, and the detector's calibration."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.framework import System

from diagrams.world.names import ARM_JOINTS
from models.errors import InputError
from systems.detector import NEVER as OFF  # a gamma at which no detector fires
from systems.detectors import DETECTORS


@dataclass(frozen=True)
class Calibration:
    """What a detector needs beside what was learned (Eqs. 5, 6): reference errors, one a criterion (N + 1 of the recall), beta, gamma.

    The references are in the unit of the detector's errors; beta and gamma are dimensionless.
    """

    reference_errors: tuple[float, ...]
    beta: float
    gamma: float


def never_fires(criteria: int) -> Calibration:
    """The calibration of a detector with so many criteria that is switched off: alpha stays 0."""
    return Calibration((1.0,) * criteria, 1.0, OFF)


@dataclass(frozen=True)
class Controller:
    """A policy file, a detector (one of DETECTORS; a baseline's file lies beside the policy), and a calibration instead of the files'."""

    policy: Path
    detector: str = "recall"
    calibration: Calibration | None = None

    @property
    def detector_label(self) -> str:
        """The detector's short name."""
        return DETECTORS.label(self.detector)


def policy_name(rnn: str, training_seed: int = 0) -> str:
    """File name of a trained network: lstm.safetensors is that of training seed 0, lstm-1.safetensors that of seed 1."""
    return f"{rnn}-{training_seed}.safetensors" if training_seed else f"{rnn}.safetensors"


def detector_file(folder: Path, detector: str) -> Path:
    """File of what that detector learned, and of its calibrations for the policies in `folder`."""
    return folder / f"{DETECTORS.label(detector)}.safetensors"


def stored_calibration(detector: str, policy, folder: Path, gamma: float | None = None) -> Calibration:
    """The calibration in the files in `folder`; `policy`: see models/inference.py. With a `gamma`: the paper's rule (errors
    referred to their means).

    Raises InputError for a policy without, WeightsError for a baseline's file that is missing, damaged, or without one for this policy.
    """
    from models.files.detectors import calibration_of, load_detector

    if detector == "recall":
        references, gamma = (policy.reference_errors, policy.gamma) if gamma is None else (policy.mean_errors, gamma)
        if references is None or policy.beta is None or gamma is None:
            raise InputError("the policy has no calibration: run diagrams/calibrate.py on its weight file")
        return Calibration(tuple(references), policy.beta, gamma)
    path = detector_file(folder, detector)
    found = calibration_of(path, load_detector(path, detector), policy.hash)
    return Calibration(tuple(found["mean_errors"]), found["beta"], found["gamma"] if gamma is None else gamma)


def learned_hash(folder: Path, detector: str, policy_hash: str) -> str:
    """Of what the baseline's file in `folder` says for that policy; calibrations of other policies, added later, leave it as it is.

    Raises WeightsError for a file that is missing, damaged, or without a calibration for the policy.
    """
    from models.files.detectors import calibration_of, load_detector

    path = detector_file(folder, detector)
    found = load_detector(path, detector)
    digest = hashlib.sha256(json.dumps(calibration_of(path, found, policy_hash), sort_keys=True).encode())
    for _, array in sorted(found.arrays.items()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def make_detector(
    detector: str, policy, folder: Path, calibration: Calibration | None = None
) -> tuple[System, Calibration]:
    """The detector of that name for `policy`, and its calibration: `calibration`, or the one in the files.

    Raises as stored_calibration does, and InputError where scikit-learn is not installed.
    """
    from models.files.detectors import StoredDetector, load_detector

    DETECTORS[detector]
    if calibration is None:
        calibration = stored_calibration(detector, policy, folder)
    stored = (
        StoredDetector("recall")
        if detector == "recall"
        else load_detector(detector_file(folder, detector), detector)
    )
    return build_detector(stored, policy), calibration


def build_detector(stored, policy) -> System:
    """The detector of `stored` (models/files/detectors.py) for `policy`; raises InputError where scikit-learn is not installed."""
    try:
        return DETECTORS[stored.detector].build(policy, ARM_JOINTS, stored.arrays)
    except ModuleNotFoundError as error:
        raise InputError(f"the detector {stored.detector} needs {error.name}: pip install -e '.[sweep]'") from error
