"""The files of the detectors that learn from runs."""

import numpy as np
import pytest

from models.files.container import WeightsError
from models.files.detectors import StoredDetector, calibration_of, load_detector, save_detector
from models.files.tensors import write_tensors

CALIBRATION = {"mean_errors": [0.1, 0.2], "beta": 30.0, "gamma": 5.0}


def test_a_file_gives_back_what_it_was_given(tmp_path):
    arrays = {"a": np.arange(6, dtype=np.int16).reshape(2, 3), "b": np.array([0.1, 0.2], np.float32)}
    path = tmp_path / "mine.safetensors"
    save_detector(path, StoredDetector("mine", arrays, {"aa": CALIBRATION}, {"runs": 3}))
    found = load_detector(path, "mine")
    assert set(found.arrays) == {"a", "b"}
    for name, array in arrays.items():
        assert found.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(found.arrays[name], array)
    assert (found.detector, found.metadata) == ("mine", {"runs": 3})
    assert calibration_of(path, found, "aa") == CALIBRATION


def test_what_does_not_fit_is_refused(tmp_path):
    path = tmp_path / "knn.safetensors"
    save_detector(path, StoredDetector("knn", calibrations={"aa": {"beta": 30.0}}))
    stored = load_detector(path, "knn")
    with pytest.raises(WeightsError, match=r"detector 'knn', not 'subspace'.*baselines\.py"):
        load_detector(path, "subspace")
    with pytest.raises(WeightsError, match="no calibration for the policy whose file has the hash bb"):
        calibration_of(path, stored, "bb")
    with pytest.raises(WeightsError, match=r"without gamma and mean_errors for aa.*baselines\.py"):
        calibration_of(path, stored, "aa")
    with pytest.raises(WeightsError, match=r"does not exist.*baselines\.py"):
        load_detector(tmp_path / "nowhere", "knn")


@pytest.mark.parametrize(
    "changed",
    [
        {"mean_errors": [0.1, 0.0]}, {"mean_errors": []}, {"mean_errors": 0.1}, {"mean_errors": ["a"]},
        {"mean_errors": [0.1, float("nan")]}, {"beta": 0.0}, {"beta": "thirty"}, {"beta": [30.0]},
        {"gamma": float("inf")}, {"gamma": None}, {"gamma": -1.0}, {"gamma": 0.0},
        {"gamma": "1"}, {"beta": True}, {"mean_errors": [[0.1], [0.1, 0.2]]},
    ],
)  # fmt: skip
def test_a_calibration_of_no_use_is_named(tmp_path, changed):
    stored = StoredDetector("knn", calibrations={"aa": CALIBRATION | changed})
    with pytest.raises(WeightsError, match=rf"has the {next(iter(changed))} .* for aa, not .*baselines\.py"):
        calibration_of(tmp_path, stored, "aa")


@pytest.mark.parametrize("calibrations", [[CALIBRATION], "aa", None, {"aa": 5}, {"aa": None}])
def test_what_is_no_calibration_is_none(tmp_path, calibrations):
    with pytest.raises(WeightsError, match="no calibration for the policy whose file has the hash aa"):
        calibration_of(tmp_path, StoredDetector("knn", calibrations=calibrations), "aa")


def test_a_header_without_calibrations_is_named(tmp_path):
    path = tmp_path / "subspace.safetensors"
    write_tensors(path, {"axes": np.zeros((2, 10, 2))}, {"kind": "detector", "method": "subspace", "metadata": {}})
    with pytest.raises(WeightsError, match=r"has no calibrations in its header.*baselines\.py"):
        load_detector(path, "subspace")


@pytest.mark.parametrize("changed", [{"calibrations": []}, {"metadata": "none"}])
def test_a_header_of_other_types_is_named(tmp_path, changed):
    path, header = tmp_path / "subspace.safetensors", {"calibrations": {}, "metadata": {}} | changed
    write_tensors(path, {"axes": np.zeros((2, 10, 2))}, {"kind": "detector", "method": "subspace"} | header)
    with pytest.raises(WeightsError, match=rf"has the {next(iter(changed))} .* in its header, no map"):
        load_detector(path, "subspace")


def test_the_remedy_is_the_program_that_makes_it(tmp_path):
    with pytest.raises(WeightsError, match=r"Make it with `python diagrams/calibrate\.py --policy`"):
        calibration_of(tmp_path, StoredDetector("knn"), "aa", "calibrate.py --policy")
