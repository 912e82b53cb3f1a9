"""Which controller: the policy's file, its detector, and the detector's calibration."""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.framework import System

from diagrams.world.names import ARM_JOINTS, DECODER, ENCODER
from models.checks import require_plain
from models.data.runs import of_policy
from models.errors import InputError
from models.networks import network_label
from models.policy import POLICIES
from systems.detector import NEVER
from systems.detectors import DETECTORS
from systems.recoveries.registry import SHIPPED

RECALL = "recall"  # the detector whose calibration is in the policy's own file
UNCALIBRATED = {"never", "oracle"}  # detectors without a calibration
UNFITTED = {RECALL, *UNCALIBRATED}  # detectors without a file


@dataclass(frozen=True)
class Calibration:
    """What a detector needs beside what was learned (Eqs. 5, 6); beta and gamma are dimensionless."""

    mean_errors: tuple[float, ...]  # one a criterion (N + 1 of the recall), in the unit of the detector's errors
    beta: float
    gamma: float


def never_fires(criteria: int) -> Calibration:
    """The calibration of a detector with so many criteria that is switched off: alpha stays 0."""
    return Calibration((1.0,) * criteria, 1.0, NEVER)


@dataclass(frozen=True)
class Controller:
    """A policy file, a detector of DETECTORS (what it learned lies beside it), a calibration instead of the files'.

    With `spec`, package.module:Class, that policy instead of the file, by which then its name and folder are given.
    """

    policy: Path
    detector: str = "recall"
    calibration: Calibration | None = None
    spec: str | None = None
    recovery: str = SHIPPED  # of systems/recoveries/

    def load(self):
        """The policy, see models/inference.py; raises WeightsError, or InputError as `own_policy` does."""
        from models.inference import Policy, own_policy

        return Policy(self.policy) if self.spec is None else own_policy(self.spec, self.policy.parent)


def controller_of(folder: Path, rnn: str, detector: str, own: str | None = None, training_seed: int = 0) -> Controller:
    """The network in `folder` that `rnn` names, or the policy `own` (package.module:Class), under that detector.

    Raises InputError where there is none.
    """
    if own is not None:
        return Controller(folder / POLICIES.label(own), detector, spec=own)
    return Controller(policy_file(folder, rnn, training_seed), detector)


def policy_name(label: str, training_seed: int = 0) -> str:
    """File name of the network with that short name: lstm.onnx of training seed 0, lstm-1.onnx of 1."""
    return f"{label}-{training_seed}.onnx" if training_seed else f"{label}.onnx"


def policy_file(folder: Path, rnn: str, training_seed: int = 0) -> Path:
    """The file in `folder` of the network that `rnn` names; raises InputError where there is none."""
    path = folder / policy_name(network_label(rnn), training_seed)
    require_plain(path, "give another folder, or put the network's file there")
    if not path.is_file():
        files = (found for found in folder.glob("*.onnx") if found.name not in (ENCODER, DECODER))
        there = sorted(found.stem for found in files if training_seed or not re.search(r"-\d+$", found.stem))
        seed = f" of training seed {training_seed}" if training_seed else ""
        remedy = f"choose from {', '.join(there)}, or train one" if there else "give another folder, or train one"
        raise InputError(f"there is no network '{rnn}'{seed} in {folder}: {remedy} with `python -m models.training`")
    return path


def require_named(policy, rnn: str, path: Path) -> None:
    """Raises InputError unless `policy`, of the file `path`, is the network that `rnn` names."""
    if policy.name != (label := network_label(rnn)):
        raise InputError(
            f"{path} holds the network '{policy.name}', not '{label}': give a file its network's name "
            "(sweep.py takes other training seeds by --training-seeds)"
        )


def detector_file(folder: Path, detector: str) -> Path:
    """Where what a detector learned, and its calibrations, lie beside the policies in `folder`."""
    return folder / f"{DETECTORS.label(detector)}.safetensors"


def stored_calibration(detector: str, policy, folder: Path, gamma: float | None = None) -> Calibration:
    """The calibration in the files in `folder`, with `gamma` instead of theirs if one is given.

    `policy`: see models/inference.py. Raises InputError for a policy without, WeightsError for a detector's file that
    is missing, damaged, or without a calibration for this policy.
    """
    from models.files.container import WeightsError
    from models.files.detectors import calibration_of, load_detector

    own = getattr(policy, "calibrated_beside", False)
    if DETECTORS.label(detector) == RECALL and not own:
        means, gamma = policy.mean_errors, policy.gamma if gamma is None else gamma
        if means is None or policy.beta is None or gamma is None:
            raise InputError(f"{policy.path} has no calibration: run diagrams/calibrate.py on it")
        return Calibration(tuple(means), policy.beta, gamma)
    if DETECTORS.label(detector) in UNCALIBRATED:
        return never_fires(1)
    path = detector_file(folder, detector)
    by = "calibrate.py --policy" if own else "baselines.py"
    if own and not path.is_file():
        raise InputError(f"there is no calibration of '{detector}' for {policy.name} in {folder}: run calibrate.py")
    found = calibration_of(path, load_detector(path, DETECTORS.label(detector)), policy.hash, by)
    criteria = make_detector(detector, policy, folder).GetOutputPort("errors").size()
    if len(found["mean_errors"]) != criteria:
        raise WeightsError(
            path, f"has {len(found['mean_errors'])} mean_errors for {policy.name}, where the detector has {criteria}",
            f"Run diagrams/{by} again",
        )  # fmt: skip
    return Calibration(tuple(found["mean_errors"]), found["beta"], found["gamma"] if gamma is None else gamma)


def learned_hash(folder: Path, detector: str, policy_hash: str) -> str:
    """SHA-256 of what the detector's file in `folder` says for that policy alone; raises as `stored_calibration`."""
    from models.files.detectors import calibration_of, load_detector

    path = detector_file(folder, detector)
    found = load_detector(path, DETECTORS.label(detector))
    calibration = json.dumps(calibration_of(path, found, policy_hash), sort_keys=True).encode()
    return arrays_hash(of_policy(policy_hash, found.arrays), calibration)


def arrays_hash(arrays: dict[str, np.ndarray], before: bytes = b"") -> str:
    """SHA-256 of `before` and of what a detector learned."""
    total = hashlib.sha256(before)
    for _, array in sorted(arrays.items()):
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def make_detector(detector: str, policy, folder: Path) -> System:
    """The detector of that name for `policy`, not calibrated yet, from its file in `folder`.

    Raises InputError for an unknown name, or a policy that the detector is not for (such as one that recalls fewer
    ticks than its windows have), WeightsError for a file that is missing or damaged.
    """
    from models.files.detectors import load_detector

    label = DETECTORS.label(detector)
    stored = {} if label in UNFITTED else load_detector(detector_file(folder, detector), label).arrays
    arrays = of_policy(getattr(policy, "hash", ""), stored)
    whose = "" if label in UNFITTED else f"{detector_file(folder, detector)}: "
    try:
        system = DETECTORS[detector].build(policy, ARM_JOINTS, arrays)
    except InputError as error:  # of the file
        raise InputError(f"{whose}{error}") from error
    except ValueError as error:
        raise InputError(f"{whose}the detector '{label}' cannot be built for this policy: {error}") from error
    if not isinstance(system, System):
        raise InputError(
            f"the detector '{label}' cannot be built: its `build` returns {system!r:.60}, no system of Drake"
        )
    return system
