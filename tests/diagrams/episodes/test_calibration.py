"""Which controller: detectors by their names, their files, and what is said where something is missing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.episodes.calibration import (
    Calibration,
    detector_file,
    learned_hash,
    make_detector,
    never_fires,
    policy_file,
    policy_name,
    stored_calibration,
)
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.detectors import StoredDetector, load_detector, save_detector
from models.files.tensors import WeightsError
from models.inference import Policy
from systems.detectors import DETECTORS
from tests.diagrams.untrained import save_untrained

OUTSIDE = "tests.systems.outside_detector:FarFromHome"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An untrained network, and the detectors fitted to an arm that waves a little and calibrated for it."""
    folder = save_untrained(tmp_path_factory.mktemp("weights"))
    rng, home = np.random.default_rng(0), World().initial_posture[:7]
    runs = [home + 0.1 * np.sin(0.1 * np.arange(60)[:, None] * rng.uniform(0.5, 1.5, 7)) for _ in range(3)]
    policy = Policy(folder / "lstm.onnx")
    for spec in ("knn", "subspace", OUTSIDE):
        found = {"mean_errors": [0.5] * (1 if spec == OUTSIDE else 7), "beta": 10.0, "gamma": 4.0}
        stored = StoredDetector(DETECTORS.label(spec), DETECTORS[spec].fit(runs), {policy.hash: found})
        save_detector(detector_file(folder, spec), stored)
    return folder


@pytest.mark.parametrize(
    ("spec", "criteria"), [("recall", 11), ("knn", 7), ("subspace", 7), ("never", 1), (OUTSIDE, 1)]
)
def test_detectors_by_name(folder, spec, criteria):
    policy = Policy(folder / "lstm.onnx")
    detector = make_detector(spec, policy, folder)
    assert isinstance(detector, DETECTORS[spec])
    assert detector.GetOutputPort("errors").size() == criteria
    if spec not in ("recall", "never"):
        assert stored_calibration(spec, policy, folder) == Calibration((0.5,) * criteria, 10.0, 4.0)


def test_the_network_alone_needs_no_file(tmp_path, folder):
    policy = Policy(folder / "lstm.onnx")
    for gamma in (None, 3.0):
        assert stored_calibration("never", policy, tmp_path, gamma) == never_fires(1)
    assert isinstance(make_detector("never", policy, tmp_path), DETECTORS["never"])


def test_another_gamma_takes_the_place_of_the_stored_one(folder):
    policy = Policy(folder / "lstm.onnx")
    policy.mean_errors = np.full(11, 2.0)
    assert stored_calibration("recall", policy, folder) == Calibration((2.0,) * 11, 30.0, 10.0)
    assert stored_calibration("recall", policy, folder, gamma=3.0) == Calibration((2.0,) * 11, 30.0, 3.0)
    assert stored_calibration("knn", policy, folder, gamma=3.0) == Calibration((0.5,) * 7, 10.0, 3.0)


def test_the_hash_is_that_of_what_decides(folder, tmp_path):
    policy = Policy(folder / "lstm.onnx")
    stored, before = load_detector(folder / "knn.safetensors", "knn"), learned_hash(folder, "knn", policy.hash)

    def hash_of(changed):
        save_detector(tmp_path / "knn.safetensors", changed)
        return learned_hash(tmp_path, "knn", policy.hash)

    found = stored.calibrations[policy.hash]
    assert hash_of(replace(stored, calibrations=stored.calibrations | {"other": found})) == before
    assert hash_of(replace(stored, calibrations={policy.hash: found | {"gamma": 5.0}})) != before
    assert hash_of(replace(stored, arrays=stored.arrays | {"angles": stored.arrays["angles"] + 1})) != before


def test_a_calibration_of_another_number_of_criteria_is_refused(folder, tmp_path):
    policy, stored = Policy(folder / "lstm.onnx"), load_detector(folder / "knn.safetensors", "knn")
    stored.calibrations[policy.hash] |= {"mean_errors": [0.5] * 6}
    save_detector(tmp_path / "knn.safetensors", stored)
    with pytest.raises(WeightsError, match=r"knn\.safetensors: has 6 mean_errors for lstm, where the detector has 7"):
        stored_calibration("knn", policy, tmp_path)


def test_what_is_missing_is_said(folder, tmp_path):
    policy = Policy(folder / "lstm.onnx")
    with pytest.raises(InputError, match="no detector 'svm'"):
        make_detector("svm", policy, folder)
    with pytest.raises(WeightsError, match=r"knn\.safetensors: the weight file does not exist"):
        make_detector("knn", policy, tmp_path)
    save_detector(tmp_path / "far.safetensors", StoredDetector("far"))
    with pytest.raises(WeightsError, match="no calibration for the policy"):
        stored_calibration(OUTSIDE, policy, tmp_path)
    policy.gamma = None
    with pytest.raises(InputError, match=r"lstm\.onnx has no calibration: run diagrams/calibrate\.py on it"):
        stored_calibration("recall", policy, folder)


@pytest.mark.parametrize("spec", ["knn", "subspace"])
def test_a_policy_that_recalls_less_than_a_window_is_refused(folder, spec):
    policy = Policy(folder / "lstm.onnx")
    short = SimpleNamespace(
        posture_size=policy.posture_size, state_size=policy.state_size, scaling=policy.scaling, horizon=4
    )
    with pytest.raises(InputError, match=rf"'{spec}' cannot be built for this policy: window is 10.* at most 6"):
        make_detector(spec, short, folder)


def test_a_file_without_what_was_learned_is_named_as_such(folder, tmp_path):
    policy = Policy(folder / "lstm.onnx")
    save_detector(detector_file(tmp_path, "knn"), StoredDetector("knn"))
    with pytest.raises(InputError, match=r"knn\.safetensors: it holds .*angles") as error:
        make_detector("knn", policy, tmp_path)
    assert "cannot be built for this policy" not in str(error.value)


def test_names_of_policies(tmp_path):
    assert [policy_name("gru", seed) for seed in (0, 1)] == ["gru.onnx", "gru-1.onnx"]
    (tmp_path / "lstm.onnx").mkdir()
    with pytest.raises(InputError, match=r"lstm\.onnx is a folder, no plain file: give another folder"):
        policy_file(tmp_path, "lstm")
