"""Windows, leading axes, and the files of the baselines."""

import numpy as np
import pytest
import torch

from models.files.baselines import (
    StoredDetector,
    calibration_of,
    leading_axes,
    load_detector,
    posture_windows,
    save_detector,
    stored_as,
)
from models.files.weights import WeightsError, write_tensors

CALIBRATION = {"mean_errors": [0.1, 0.2], "beta": 30.0, "gamma": 5.0}


def test_windows_are_newest_first_and_never_of_two_runs():
    runs = [np.array([[0, 10], [1, 11], [2, 12], [3, 13]]), np.array([[4, 14], [5, 15], [6, 16]])]
    windows = posture_windows(runs, 3)
    assert windows.tolist() == [[[2, 1, 0], [3, 2, 1], [6, 5, 4]], [[12, 11, 10], [13, 12, 11], [16, 15, 14]]]


def test_leading_axes_are_those_of_the_decomposition():
    windows = 1.0 + np.cumsum(np.random.default_rng(0).normal(size=(2, 200, 10)), axis=2)
    axes = leading_axes(windows)
    assert axes.shape == (2, 10, 2)
    for rows, found in zip(windows, axes, strict=True):
        expected = np.linalg.svd(rows.T)[0][:, :2]
        assert found @ found.T == pytest.approx(expected @ expected.T, abs=1e-9)  # the same plane
    assert np.array_equal(axes, leading_axes(windows))


def test_knn_file_gives_back_what_is_evaluated(tmp_path):
    runs = stored_as([np.random.default_rng(n).uniform(-3, 3, (20 + n, 2)) for n in range(3)])
    path = tmp_path / "knn.safetensors"
    save_detector(path, StoredDetector("knn", runs=runs, calibrations={"aa": CALIBRATION}, metadata={"runs": 3}))
    found = load_detector(path, "knn")
    assert all(np.allclose(a, b, atol=1e-12) for a, b in zip(runs, found.runs, strict=True))
    assert (found.axes, found.metadata) == (None, {"runs": 3})
    assert calibration_of(path, found, "aa") == CALIBRATION
    assert path.stat().st_size < 2 * 2 * 63 + 2000  # 16 bits a number


def test_subspace_file(tmp_path):
    axes = leading_axes(np.random.default_rng(0).normal(size=(2, 50, 10)))
    save_detector(tmp_path / "subspace.safetensors", StoredDetector("subspace", axes=axes))
    assert load_detector(tmp_path / "subspace.safetensors", "subspace").axes == pytest.approx(axes, abs=1e-6)


def test_what_does_not_fit_is_refused(tmp_path):
    path = tmp_path / "knn.safetensors"
    with pytest.raises(ValueError, match=r"4\.00 rad cannot be stored"):
        save_detector(path, StoredDetector("knn", runs=[np.full((10, 2), 4.0)]))
    save_detector(path, StoredDetector("knn", runs=[np.zeros((10, 2))]))
    with pytest.raises(WeightsError, match=r"method 'knn', not 'subspace'.*baselines\.py"):
        load_detector(path, "subspace")
    with pytest.raises(WeightsError, match="no calibration for the policy whose file has the hash bb"):
        calibration_of(path, load_detector(path, "knn"), "bb")
    with pytest.raises(WeightsError, match="does not exist"):
        load_detector(tmp_path / "nowhere", "knn")


def test_half_a_calibration_is_named(tmp_path):
    detector = StoredDetector("knn", calibrations={"aa": {"beta": 30.0}})
    with pytest.raises(WeightsError, match=r"without gamma and mean_errors for aa.*baselines\.py"):
        calibration_of(tmp_path / "knn.safetensors", detector, "aa")


def test_a_header_without_calibrations_is_named(tmp_path):
    path = tmp_path / "subspace.safetensors"
    write_tensors(path, {"axes": torch.zeros(2, 10, 2)}, {"kind": "detector", "method": "subspace", "metadata": {}})
    with pytest.raises(WeightsError, match=r"has no calibrations in its header.*baselines\.py"):
        load_detector(path, "subspace")
