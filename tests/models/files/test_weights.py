import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from models.errors import InputError
from models.files.container import WeightsError, file_hash
from models.files.detectors import StoredDetector, save_detector
from models.files.graphs import write_graph
from models.files.weights import load_autoencoder, load_policy, save_autoencoder, save_policy
from models.inference import Policy
from models.networks.cae import ConvolutionalAutoencoder
from models.networks.onnx_export import policy_graph
from tests.models import handmade
from tests.models.conftest import make_policy
from tests.models.outside import Elman


def test_autoencoder_round_trip(tmp_path: Path, autoencoder_file: Path) -> None:
    model, metadata = load_autoencoder(autoencoder_file)
    assert metadata == {"data_hash": "abc"}
    assert not model.training
    save_autoencoder(tmp_path / "again.safetensors", model, metadata)
    again, _ = load_autoencoder(tmp_path / "again.safetensors")
    for (name, a), b in zip(model.state_dict().items(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b, msg=name)


@pytest.mark.parametrize("name", ["lstm", "gru", "mtrnn"])
def test_policy_round_trip(tmp_path: Path, name: str) -> None:
    policy = make_policy(name)
    policy.mean_errors, policy.beta, policy.gamma = np.linspace(0.1, 1.1, 11), 30.0, 60.0
    path = tmp_path / "p.onnx"
    save_policy(path, policy)
    read = load_policy(path)
    for a, b in zip(
        [*policy.rnn.parameters(), *policy.recall.parameters()],
        [*read.rnn.parameters(), *read.recall.parameters()],
        strict=True,
    ):
        assert torch.equal(a.half().float() if a.ndim > 1 else a, b)
    np.testing.assert_array_equal(read.mean_errors, policy.mean_errors)
    np.testing.assert_array_equal(read.scaling.upper, policy.scaling.upper)
    assert (read.beta, read.gamma, read.metadata, read.rnn.name) == (30.0, 60.0, policy.metadata, name)


def test_same_content_same_hash(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_policy(tmp_path / name, make_policy())
    assert file_hash(tmp_path / "a") == file_hash(tmp_path / "b")


def test_candidate_without_heads_is_refused_by_the_running_policy(tmp_path: Path) -> None:
    path = tmp_path / "rnn-10.onnx"
    save_policy(path, make_policy(recall=False))
    assert load_policy(path).recall is None
    with pytest.raises(WeightsError, match="training recall"):
        Policy(path)


def test_missing_file(tmp_path: Path) -> None:
    for read in (load_policy, load_autoencoder, file_hash):
        with pytest.raises(WeightsError, match=r"none\.safetensors: the weight file does not exist.*train"):
            read(tmp_path / "none.safetensors")


@pytest.mark.parametrize("keep", [0, 5, 1000, -100])
def test_damaged_file(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "p.onnx"
    save_policy(path, make_policy())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(WeightsError, match=r"p\.onnx: .*damaged"):
        load_policy(path)


def test_wrong_kind_missing_tensor_and_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "p.onnx"
    save_policy(path, make_policy())
    with pytest.raises(WeightsError, match=r"p\.onnx: the weight file is damaged"):
        load_autoencoder(path)
    save_detector(tmp_path / "knn", StoredDetector("knn"))
    with pytest.raises(WeightsError, match=r"'detector'.*'autoencoder'.* needed"):
        load_autoencoder(tmp_path / "knn")
    with pytest.raises(WeightsError, match=r"knn: the weight file is damaged .*Take it from the repository"):
        load_policy(tmp_path / "knn")
    header = {"format": 1, "kind": "autoencoder", "feature_activation": "tanh", "metadata": {}}
    save_file({"x": torch.zeros(1)}, path, {"header": json.dumps(header)})
    with pytest.raises(WeightsError, match="does not fit the network"):
        load_autoencoder(path)
    policy = make_policy()
    with torch.no_grad():
        policy.rnn.output.bias[0] = float("nan")
    save_policy(path, policy)
    with pytest.raises(WeightsError, match="not finite"):
        load_policy(path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"feature_activation": None}, "does not describe an autoencoder"),
        ({"feature_activation": "sine"}, "does not describe an autoencoder .*sine"),
        ({"feature_activation": []}, "does not describe an autoencoder"),
        ({"metadata": None}, "does not describe an autoencoder .*metadata"),
        ({"metadata": [5]}, r"does not describe an autoencoder .*metadata is \[5\]"),
    ],
)
def test_damaged_header_of_an_autoencoder(tmp_path: Path, change: dict, named: str) -> None:
    header = {"format": 1, "kind": "autoencoder", "feature_activation": "tanh", "metadata": {}} | change
    header = {name: value for name, value in header.items() if value is not None}
    save_file({"x": torch.zeros(1)}, tmp_path / "cae", {"header": json.dumps(header)})
    with pytest.raises(WeightsError, match=named):
        load_autoencoder(tmp_path / "cae")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"lower": [0.0] * 8, "upper": [0.0] * 8}, "lower < upper"),
        ({"initial_posture": [0.0] * 7}, r"initial_posture has the shape \(7,\)"),
        ({"initial_posture": "home"}, "could not convert"),
        ({"lower": None}, "MinMaxScaling needs"),
        ({"metadata": []}, r"metadata is \[\]"),
        ({"name": 3}, "name is 3"),
        ({"name": None}, "name is None"),
        ({"encoder_hash": 3}, "encoder_hash is 3"),
        ({"torch": "x"}, "torch is 'x'"),
        ({"beta": "x"}, "could not convert"),
        ({"beta": 0.0}, "beta is 0.0: numbers above 0 are needed"),
        ({"beta": 10**400}, "too large"),
        ({"mean_errors": [1.0, 0.0, 1.0]}, "mean_errors is .*numbers above 0"),
        ({"gamma": float("nan")}, "gamma is nan"),
        ({"gamma": -1.0}, "gamma is -1.0: numbers above 0 are needed"),
        ({"torch": {"rnn": "gru", "posture_size": 8, "feature_size": 30, "recall": None}}, "network 'gru' 'lstm'"),
        ({"initial_posture": [float("inf")] * 8}, "initial_posture is"),
    ],
)
def test_damaged_header_of_a_policy(tmp_path: Path, change: dict, named: str) -> None:
    header = make_policy().header() | change
    write_graph(tmp_path / "p.onnx", handmade.policy(None).SerializeToString(), header)
    for read in (load_policy, Policy):
        with pytest.raises(WeightsError, match=rf"its header does not describe a policy .*{named}"):
            read(tmp_path / "p.onnx")
    del header["encoder_hash"]
    write_graph(tmp_path / "p.onnx", handmade.policy(None).SerializeToString(), header)
    with pytest.raises(WeightsError, match="does not describe a policy"):
        load_policy(tmp_path / "p.onnx")


def test_torch_takes_back_only_what_it_made(tmp_path: Path) -> None:
    header = make_policy().header()
    write_graph(tmp_path / "p.onnx", handmade.policy(None).SerializeToString(), header)
    with pytest.raises(WeightsError, match="was not made by torch here"):
        load_policy(tmp_path / "p.onnx")
    torch_made = {"rnn": "lstm", "posture_size": 8, "feature_size": 30, "recall": {"horizon": 2, "hidden": None}}
    write_graph(tmp_path / "p.onnx", handmade.policy(None).SerializeToString(), header | {"torch": torch_made})
    with pytest.raises(WeightsError, match="does not fit the network"):
        load_policy(tmp_path / "p.onnx")


def test_a_network_whose_weights_the_export_folds_is_refused(tmp_path: Path) -> None:
    class Unused(Elman):
        def __init__(self, *sizes: int) -> None:
            super().__init__(*sizes)
            self.spare = torch.nn.Linear(3, 3)

    with pytest.raises(InputError, match=r"elman cannot be exported .*rnn\.spare\.bias, rnn\.spare\.weight"):
        policy_graph(Unused(), None)


def test_a_network_that_cannot_be_exported_is_refused() -> None:
    class Choosy(Elman):
        def step(self, x: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            return super().step(x if float(x.sum()) > 0.0 else -x, state)

    with pytest.raises(InputError, match=r"elman cannot be exported as a graph \([^\x1b]*\): see `step`"):
        policy_graph(Choosy(), None)


def test_too_little_memory_is_no_fault_of_the_network() -> None:
    class Large(Elman):
        def step(self, x: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            raise MemoryError("std::bad_alloc")

    with pytest.raises(MemoryError, match="bad_alloc"):
        policy_graph(Large(), None)


def test_a_folder_is_no_weight_file(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="is a folder, a pipe or a device"):
        file_hash(tmp_path)


def test_error_comes_back_from_another_process() -> None:
    error = WeightsError(Path("p"), "wrong", "Right it")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (WeightsError, str(error)) == (WeightsError, "p: wrong. Right it")


def test_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cae.safetensors"
    path.write_bytes(b"old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        save_autoencoder(path, ConvolutionalAutoencoder())
    assert path.read_bytes() == b"old"
