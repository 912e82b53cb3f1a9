"""KnnDetector and SubspaceDetector: hand-worked numbers, brute force by scikit-learn, what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.decomposition import TruncatedSVD
from sklearn.neighbors import NearestNeighbors

from models.data.scaling import MinMaxScaling
from systems.detector import check_detector
from systems.knn_detector import KnnDetector
from systems.subspace_detector import SubspaceDetector
from tests.systems.system_checks import evaluate

# Scaled 0 is (1, 10, 0) rad, a scaled unit (1, 2, 1) rad.
POLICY = SimpleNamespace(
    posture_size=3, horizon=3, state_size=2, scaling=MinMaxScaling([0.0, 8.0, -1.0], [2.0, 12.0, 1.0])
)
# Rows newest first; the window of 3 samples leaves the older ones out, the two joints the third component.
HISTORY = np.array([[0.3, 0.0, 9.0], [0.2, 0.5, 9.0], [0.1, 0.0, 9.0], [7.0, 7.0, 9.0], [7.0, 7.0, 9.0]])
INPUTS = dict(posture_history=HISTORY.ravel(), recalled_postures=np.full(12, 5.0), hidden_state=np.zeros(2))
WINDOWS = np.array([[[1.0, 1.0, 1.0], [1.3, 1.2, 1.0]], [[10.0, 10.0, 10.0], [10.0, 14.0, 10.0]]])  # rad


def knn(windows=WINDOWS):
    return KnnDetector(POLICY, windows)


def constant_and_ramp():
    axes = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0]]).T / np.sqrt([3.0, 2.0])
    return np.array([axes, axes])


def subspace(axes=None):
    return SubspaceDetector(POLICY, constant_and_ramp() if axes is None else axes)


def test_knn_by_hand():
    # Joint 1: (1.3, 1.2, 1.1) is 0.1 from its second neighbour; joint 2: (10, 11, 10) is 1 from its first.
    calibration = [0.05, 2.0], 2.0, 1.5
    assert evaluate(knn(), "errors", INPUTS, calibration) == pytest.approx([0.1 / 0.05, 1.0 / 2.0])
    assert evaluate(knn(), "alpha", INPUTS, calibration) == pytest.approx([1.0 / (1.0 + np.exp(-2.0 * (2.0 - 1.5)))])


def test_subspace_by_hand():
    # Joint 1 is a ramp: no residual. Joint 2: (10, 11, 10) = 31/3 + (-1/3, 2/3, -1/3), of length^2 6/9.
    calibration = [1.0, 0.5], 2.0, 1.5
    assert evaluate(subspace(), "errors", INPUTS, calibration) == pytest.approx([0.0, 2 / 3 / 0.5], abs=1e-12)
    assert evaluate(subspace(), "alpha", INPUTS, calibration) == pytest.approx(
        [1.0 / (1.0 + np.exp(-2.0 * (4 / 3 - 1.5)))]
    )


@pytest.mark.parametrize("build", [knn, subspace])
def test_ports_that_are_no_angles_of_the_window_do_not_count(build):
    other = HISTORY.copy()
    other[:, 2], other[3:] = -3.0, 1.0
    inputs = INPUTS | dict(posture_history=other.ravel(), recalled_postures=np.zeros(12), hidden_state=np.ones(2))
    assert evaluate(build(), "errors", INPUTS).tobytes() == evaluate(build(), "errors", inputs).tobytes()


def test_an_arm_that_stands_still_is_nothing_to_the_subspace():
    still = np.tile([0.7, -0.2, 0.0], (5, 1))
    assert evaluate(subspace(), "errors", INPUTS | dict(posture_history=still.ravel())) == pytest.approx(0.0, abs=1e-12)


def random_windows(rng, count):
    """(2, count, 10) smooth, with an offset."""
    return 1.0 + 0.05 * np.cumsum(rng.normal(size=(2, count, 10)), axis=2)


def test_both_agree_with_scikit_learn():
    rng = np.random.default_rng(0)
    train, test = random_windows(rng, 300), random_windows(rng, 40)
    policy = SimpleNamespace(posture_size=2, horizon=10, state_size=1, scaling=MinMaxScaling([0, 0], [2, 2]))
    found = KnnDetector(policy, train).anomaly(test)
    for joint in range(2):
        brute = NearestNeighbors(n_neighbors=1, algorithm="brute").fit(train[joint])
        assert found[joint] == pytest.approx(brute.kneighbors(test[joint])[0][:, 0])
    axes = np.array([TruncatedSVD(2, algorithm="arpack", random_state=0).fit(rows).components_.T for rows in train])
    found = SubspaceDetector(policy, axes).anomaly(test)
    for joint in range(2):
        left = np.linalg.svd(train[joint].T, full_matrices=False)[0][:, :2]  # X = U S V', windows as columns
        expected = [q @ q - np.square(left.T @ q).sum() for q in test[joint]]
        assert found[joint] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("build", [knn, subspace])
@pytest.mark.parametrize(("size", "expected"), [(0.0, 0.0), (1e9, 1.0)])
@pytest.mark.filterwarnings("error")
def test_extreme_errors_are_safe(build, size, expected):
    spike = np.zeros((5, 3))
    spike[1] = size
    inputs = INPUTS | dict(posture_history=spike.ravel())
    assert evaluate(build(), "alpha", inputs, ([1.0, 1.0], 30.0, 60.0)) == pytest.approx([expected], abs=1e-100)


@pytest.mark.parametrize("build", [knn, subspace])
def test_they_fit_a_controller(build):
    check_detector(build(), POLICY)


@pytest.mark.parametrize(
    ("build", "learned", "message"),
    [
        (knn, np.zeros((2, 0, 3)), r"windows has shape \(2, 0, 3\).*fit again"),
        (knn, np.full((2, 4, 3), np.nan), "finite"),
        (knn, np.zeros((4, 1, 3)), "joints is 4.*at most 3"),
        (knn, np.zeros((2, 1, 6)), "window is 6.*at most 5"),
        (subspace, np.ones((2, 3, 2)), "not orthonormal"),
        (subspace, np.ones(3), r"axes has shape \(3,\)"),
    ],
)
def test_error_names_value_limit_and_remedy(build, learned, message):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        build(learned)
