"""Which controller: the policy's file, its detector, and the detector's calibration."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.framework import System

from diagrams.episodes.rollout import COMPONENT_WEIGHTS
from diagrams.world.scenario import DETECTORS
from models.errors import InputError
from systems.detector import RecallDetector


@dataclass(frozen=True)
class Calibration:
    """What a detector needs beside what was learned (Eqs. 5, 6): reference errors, one a criterion (N + 1 of the recall), beta, gamma.

    The references are in the unit of the detector's errors; beta and gamma are dimensionless.
    """

    reference_errors: tuple[float, ...]
    beta: float
    gamma: float


OFF = 1e12  # a gamma at which no detector fires


def never_fires(criteria: int) -> Calibration:
    """The calibration of a detector with so many criteria that is switched off: alpha stays 0."""
    return Calibration((1.0,) * criteria, 1.0, OFF)


@dataclass(frozen=True)
class Controller:
    """A policy file, a detector (one of DETECTORS; a baseline's file lies beside the policy), and a calibration instead of the files'."""

    policy: Path
    detector: str = "recall"
    calibration: Calibration | None = None


def policy_name(rnn: str, training_seed: int = 0) -> str:
    """File name of a trained network: lstm.safetensors is that of training seed 0, lstm-1.safetensors that of seed 1."""
    return f"{rnn}-{training_seed}.safetensors" if training_seed else f"{rnn}.safetensors"


def stored_calibration(detector: str, policy, folder: Path, gamma: float | None = None) -> Calibration:
    """The calibration in the files in `folder`; `policy`: see models/inference.py. With a `gamma`: the paper's rule (errors
    referred to their means).

    Raises InputError for a policy without, WeightsError for a baseline's file that is missing, damaged, or without one for this policy.
    """
    from models.files.detectors import calibration_of, load_detector

    if detector == "recall":
        if policy.reference_errors is None or policy.mean_errors is None or policy.beta is None or policy.gamma is None:
            raise InputError("the policy has no calibration: run diagrams/calibrate.py on its weight file")
        if gamma is not None:
            return Calibration(tuple(policy.mean_errors), policy.beta, gamma)
        return Calibration(tuple(policy.reference_errors), policy.beta, policy.gamma)
    path = folder / f"{detector}.safetensors"
    found = calibration_of(path, load_detector(path, detector), policy.hash)
    return Calibration(tuple(found["mean_errors"]), found["beta"], found["gamma"] if gamma is None else gamma)


def learned_hash(folder: Path, detector: str, policy_hash: str) -> str:
    """Of what the baseline's file in `folder` says for that policy; calibrations of other policies, added later, leave it as it is.

    Raises WeightsError for a file that is missing, damaged, or without a calibration for the policy.
    """
    from models.files.detectors import calibration_of, load_detector

    path = folder / f"{detector}.safetensors"
    found = load_detector(path, detector)
    digest = hashlib.sha256(json.dumps(calibration_of(path, found, policy_hash), sort_keys=True).encode())
    for _, array in sorted(found.arrays.items()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def make_detector(detector: str, policy, folder: Path, calibration: Calibration | None = None) -> System:
    """The detector of that name for `policy`, with `calibration` instead of the one in the files; raises as stored_calibration does."""
    from models.files.detectors import load_detector

    if detector not in DETECTORS:
        raise InputError(f"there is no detector '{detector}': choose one of {', '.join(DETECTORS)}")
    if calibration is None:
        calibration = stored_calibration(detector, policy, folder)
    if detector == "recall":
        return RecallDetector(**_arguments(policy, calibration), component_weights=COMPONENT_WEIGHTS)
    return make_window_detector(load_detector(folder / f"{detector}.safetensors", detector), policy, calibration)


def make_window_detector(stored, policy, calibration: Calibration) -> System:
    """The baseline `stored` (models/files/detectors.py) for `policy`; raises InputError where scikit-learn is not installed."""
    from models.data.windows import decode_runs, posture_windows
    from systems.knn_detector import KnnDetector
    from systems.subspace_detector import SubspaceDetector

    arguments = _arguments(policy, calibration) | {"lower": policy.scaling.lower, "upper": policy.scaling.upper}
    if stored.detector == "subspace":
        return SubspaceDetector(axes=stored.arrays["axes"].astype(float), **arguments)
    try:
        return KnnDetector(windows=posture_windows(decode_runs(stored.arrays)), **arguments)
    except ModuleNotFoundError as error:
        raise InputError(f"the detector knn needs {error.name}: pip install -e '.[sweep]'") from error


def _arguments(policy, calibration: Calibration) -> dict:
    return {
        "posture_size": policy.posture_size,
        "horizon": policy.horizon,
        "state_size": policy.state_size,
        "reference_errors": np.array(calibration.reference_errors),
        "beta": calibration.beta,
        "gamma": calibration.gamma,
    }
