"""Windows, leading axes, and runs as they are stored."""

import numpy as np
import pytest

from models.data.windows import decode_runs, encode_runs, leading_axes, posture_windows


def test_windows_are_newest_first_and_never_of_two_runs():
    runs = [np.array([[0, 10], [1, 11], [2, 12], [3, 13]]), np.array([[4, 14], [5, 15], [6, 16]])]
    windows = posture_windows(runs, 3)
    assert windows.tolist() == [[[2, 1, 0], [3, 2, 1], [6, 5, 4]], [[12, 11, 10], [13, 12, 11], [16, 15, 14]]]


def test_leading_axes_are_those_of_the_decomposition():
    windows = 1.0 + np.cumsum(np.random.default_rng(0).normal(size=(2, 200, 10)), axis=2)
    axes = leading_axes(windows)
    assert (axes.shape, axes.dtype) == ((2, 10, 2), np.float32)
    for rows, found in zip(windows, axes, strict=True):
        expected = np.linalg.svd(rows.T)[0][:, :2]
        assert found @ found.T == pytest.approx(expected @ expected.T, abs=1e-6)  # the same plane
    assert np.array_equal(axes, leading_axes(windows))


@pytest.mark.parametrize("value", [0.0, 2.0])
@pytest.mark.filterwarnings("error")
def test_leading_axes_of_a_joint_that_never_moves(value):
    moving = np.cumsum(np.random.default_rng(0).normal(size=(50, 10)), axis=1)
    still, other = leading_axes(np.stack([np.full((50, 10), value), moving]))
    assert still.T @ still == pytest.approx(np.eye(2), abs=1e-6)
    assert still @ still.T @ np.ones(10) == pytest.approx(np.ones(10), abs=1e-6)
    assert np.array_equal(other, leading_axes(moving[None])[0])


def test_runs_are_stored_in_tenths_of_a_milliradian():
    encoded = encode_runs([np.array([[0.12344, -1.0]]), np.array([[3.2, 0.0], [0.00006, 0.0]])])
    assert encoded["angles"].tolist() == [[1234, -10000], [32000, 0], [1, 0]]
    assert encoded["lengths"].tolist() == [1, 2]
    first, second = decode_runs(encoded)
    assert first == pytest.approx(np.array([[0.1234, -1.0]]), abs=1e-12)
    assert second == pytest.approx(np.array([[3.2, 0.0], [0.0001, 0.0]]), abs=1e-12)
    again = encode_runs([first, second])
    assert all(np.array_equal(encoded[name], again[name]) for name in encoded)


def test_larger_angles_are_stored_in_a_larger_unit():
    runs = [np.array([[4.0, -360.0], [0.02, 17.0]])]
    encoded = encode_runs(runs)
    assert encoded["angles"].tolist()[0] == [364, -32767]
    assert encoded["unit"] == pytest.approx([360.0 / 32767])
    assert decode_runs(encoded)[0] == pytest.approx(runs[0], abs=0.5 * 360.0 / 32767)
