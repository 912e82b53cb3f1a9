"""Detectors of the hidden state: against scipy, scikit-learn and torch, and what is refused."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist, mahalanobis
from sklearn.cluster import KMeans
from sklearn.covariance import LedoitWolf
from sklearn.decomposition import PCA

from models.data.runs import Tape, rows_of
from models.errors import InputError
from models.networks.perceptron import of_arrays
from systems import distillation_detector, flow_detector
from systems.clusters_detector import ClustersDetector
from systems.detectors import DETECTORS
from systems.distillation_detector import DistillationDetector
from systems.flow_detector import STEPS, FlowDetector
from systems.mahalanobis_detector import MahalanobisDetector
from systems.pyod_detector import pyod_detector
from tests.systems.controller_fakes import FakePolicy
from tests.systems.system_checks import evaluate

POLICY = FakePolicy()
S, F, M, N = POLICY.state_size, POLICY.feature_size, POLICY.posture_size, POLICY.horizon


def tape(seed, ticks=60, shift=0.0):
    """States and features in a plane of three directions, with noise."""
    rng = np.random.default_rng(seed)
    plane = np.random.default_rng(99).normal(size=(3, S + F))
    rows = rng.normal(size=(ticks, 3)) @ plane + 0.1 * rng.normal(size=(ticks, S + F)) + shift
    empty = np.zeros((ticks, F))
    postures = np.zeros((ticks, M)), np.zeros((ticks, N + 1, M))
    return Tape(*postures, rows[:, :S], rows[:, S:], empty, np.zeros(ticks))


TRAIN, TEST = [tape(0), tape(1)], tape(2)


@pytest.fixture(autouse=True, scope="module")
def short():
    """A training of a second."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (distillation_detector, flow_detector):
            patch.setattr(module, "UPDATES", 150)
        yield


@pytest.fixture(scope="module")
def fitted():
    names = ("mahalanobis", "pca_kmeans", "rnd", "logpzo", "pyod:ECOD", "pyod:KNN")
    return {name: DETECTORS[name].fit(TRAIN) for name in names}


def inputs(row):
    empty = dict(posture_history=np.zeros((N + 2) * M), recalled_postures=np.zeros((N + 1) * M))
    return empty | dict(hidden_state=row[:S], features=row[S:])


def test_mahalanobis_is_scipys_with_the_covariance_of_scikit_learn(fitted):
    detector = MahalanobisDetector.build(POLICY, 3, fitted["mahalanobis"])
    states = rows_of(TRAIN, "hidden_state")
    found = LedoitWolf().fit(states)
    assert found.shrinkage_ > 0.0
    expected = [mahalanobis(c, states.mean(axis=0), np.linalg.inv(found.covariance_)) ** 2 for c in TEST.hidden_state]
    assert detector.anomaly(TEST.hidden_state) == pytest.approx(expected, rel=1e-4)


def test_mahalanobis_by_hand():
    # Of x = (3, 4) and W = diag(1, 1/2): 9 + 4; the mean is 0.
    policy = FakePolicy(joints=1, horizon=1)
    policy.state_size = 2
    detector = MahalanobisDetector(policy, np.zeros(2), np.diag([1.0, 0.5]))
    empty = dict(posture_history=np.zeros(6), recalled_postures=np.zeros(4), hidden_state=[3.0, 4.0])
    assert evaluate(detector, "errors", empty, ([2.0], 1.0, 1.0)) == pytest.approx([6.5])


def test_clusters_are_scikit_learns(fitted):
    detector = ClustersDetector.build(POLICY, 3, fitted["pca_kmeans"])
    rows, test = rows_of(TRAIN, *ClustersDetector.reads), rows_of([TEST], *ClustersDetector.reads)
    axes = PCA(0.98, svd_solver="full").fit(rows)
    assert axes.n_components_ == 3 == fitted["pca_kmeans"]["axes"].shape[0]
    clusters = KMeans(64, n_init=3, random_state=0).fit(axes.transform(rows))
    expected = cdist(axes.transform(test), clusters.cluster_centers_).min(axis=1)
    assert detector.anomaly(test) == pytest.approx(expected, rel=1e-3, abs=1e-4)


def torch_of(layers):
    """The same perceptron in torch."""
    parts = []
    for weights, bias in layers:
        linear = torch.nn.Linear(weights.shape[1], weights.shape[0])
        linear.weight.data, linear.bias.data = torch.tensor(weights), torch.tensor(bias)
        parts += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*parts[:-1])


def test_distillation_is_torchs(fitted):
    arrays = fitted["rnd"]
    test = rows_of([TEST], *DistillationDetector.reads)
    scaled = torch.tensor((test - arrays["mean"]) / arrays["spread"], dtype=torch.float32)
    with torch.no_grad():
        target, predictor = (torch_of(of_arrays(name, arrays))(scaled) for name in ("target", "predictor"))
    expected = ((predictor - target) ** 2).sum(dim=1).numpy()
    assert DistillationDetector.build(POLICY, 3, arrays).anomaly(test) == pytest.approx(expected, rel=1e-3)


def test_the_flow_is_eulers_method_with_torch(fitted):
    arrays = fitted["logpzo"]
    test = rows_of([TEST], *FlowDetector.reads)
    z, field = torch.tensor((test - arrays["mean"]) / arrays["spread"], dtype=torch.float32), of_arrays("field", arrays)
    with torch.no_grad():
        for step in range(STEPS):
            time = torch.full((len(z), 1), step / STEPS)
            z = z + torch_of(field)(torch.cat([z, time], dim=1)) / STEPS
    expected = (z**2).sum(dim=1).numpy()
    assert FlowDetector.build(POLICY, 3, arrays).anomaly(test) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", ["mahalanobis", "pca_kmeans", "rnd", "logpzo", "pyod:KNN"])
def test_what_is_off_is_told_from_what_is_normal(fitted, name):
    detector = DETECTORS[name].build(POLICY, 3, fitted[name])
    off = rows_of([tape(3, shift=np.random.default_rng(5).normal(size=S + F) * 3.0)], *detector.reads)
    normal = detector.anomaly(rows_of([TEST], *detector.reads))
    assert np.all(normal >= 0.0)
    assert np.median(detector.anomaly(off)) > np.quantile(normal, 0.9)
    row = np.append(TEST.hidden_state[7], TEST.features[7])
    ports = [detector.get_input_port(i).get_name() for i in range(detector.num_input_ports())]
    given = {port: value for port, value in inputs(row).items() if port in ports}
    assert evaluate(detector, "errors", given, ([2.0], 1.0, 1.0)) == pytest.approx(normal[7:8] / 2.0, rel=1e-4)


@pytest.mark.parametrize("name", ["mahalanobis", "pca_kmeans", "rnd", "logpzo", "pyod:IForest", "pyod:LODA"])
def test_the_same_runs_give_the_same_bits(name):
    rows = rows_of([TEST], *DETECTORS[name].reads)
    first, second = (DETECTORS[name].build(POLICY, 3, DETECTORS[name].fit(TRAIN)).anomaly(rows) for _ in range(2))
    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("name", ["mahalanobis", "pca_kmeans", "rnd", "logpzo", "pyod:ECOD"])
def test_arrays_of_another_network_are_refused(fitted, name):
    other = FakePolicy(joints=2)
    with pytest.raises((ValueError, InputError), match="fit again"):
        DETECTORS[name].build(other, 2, fitted[name])
    with pytest.raises((ValueError, InputError), match="fit"):
        DETECTORS[name].build(POLICY, 3, {"a": np.zeros(1)})


def test_pyods_scores_are_pyods(fitted):
    from pyod.models.ecod import ECOD

    rows = fitted["pyod:ECOD"]["rows"].astype(float)
    model = ECOD().fit(rows)
    test = rows_of([TEST], "hidden_state", "features")
    scores, train = model.decision_function(test), model.decision_function(rows)
    expected = np.maximum(scores - train.min(), 0.0) / (train.mean() - train.min())
    detector = DETECTORS["pyod:ECOD"].build(POLICY, 3, fitted["pyod:ECOD"])
    assert detector.anomaly(test) == pytest.approx(expected)


def test_names_of_pyods():
    assert DETECTORS.label("pyod:IForest") == "pyod-IForest"
    assert pyod_detector("IForest") is DETECTORS["pyod:IForest"]
    assert pyod_detector("AutoEncoder").name == "pyod-AutoEncoder"  # of the module auto_encoder
    with pytest.raises(InputError, match="PyOD has no detector 'Nonsense': choose one of its models"):
        DETECTORS["pyod:Nonsense"]
