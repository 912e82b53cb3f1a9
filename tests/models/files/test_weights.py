import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from models.files.weights import (
    WeightsError,
    file_hash,
    load_autoencoder,
    load_policy,
    save_autoencoder,
    save_policy,
)
from models.inference import Policy
from models.networks.cae import ConvolutionalAutoencoder
from tests.models.conftest import make_policy


def test_autoencoder_round_trip(tmp_path: Path, encoder_file: Path) -> None:
    model, metadata = load_autoencoder(encoder_file)
    assert metadata == {"data_hash": "abc"}
    assert not model.training
    assert encoder_file.stat().st_size < 40e6
    save_autoencoder(tmp_path / "again.safetensors", model, metadata)
    again, _ = load_autoencoder(tmp_path / "again.safetensors")
    for (name, a), b in zip(model.state_dict().items(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(a, b, msg=name)


@pytest.mark.parametrize("name", ["lstm", "gru", "mtrnn"])
def test_policy_round_trip(tmp_path: Path, name: str) -> None:
    policy = make_policy(name)
    policy.mean_errors, policy.beta, policy.gamma = np.linspace(0.1, 1.1, 11), 30.0, 60.0
    policy.reference_errors = 2.0 * policy.mean_errors
    path = tmp_path / "p.safetensors"
    save_policy(path, policy)
    read = load_policy(path)
    for a, b in zip(
        [*policy.rnn.parameters(), *policy.recall.parameters()],
        [*read.rnn.parameters(), *read.recall.parameters()],
        strict=True,
    ):
        assert torch.equal(a.half().float() if a.ndim > 1 else a, b)
    np.testing.assert_array_equal(read.mean_errors, policy.mean_errors)
    np.testing.assert_array_equal(read.reference_errors, policy.reference_errors)
    np.testing.assert_array_equal(read.scaling.upper, policy.scaling.upper)
    assert (read.beta, read.gamma, read.metadata, read.rnn.name) == (30.0, 60.0, policy.metadata, name)


def test_same_content_same_hash(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_policy(tmp_path / name, make_policy())
    assert file_hash(tmp_path / "a") == file_hash(tmp_path / "b")


def test_candidate_without_heads_is_refused_by_the_running_policy(tmp_path: Path) -> None:
    path = tmp_path / "rnn-10.safetensors"
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
    path = tmp_path / "p.safetensors"
    save_policy(path, make_policy())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(WeightsError, match=r"p\.safetensors: .*damaged"):
        load_policy(path)


def test_wrong_kind_missing_tensor_and_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    save_policy(path, make_policy())
    with pytest.raises(WeightsError, match=r"'policy'.*'autoencoder'.* needed"):
        load_autoencoder(path)
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
    ],
)
def test_damaged_header_of_an_autoencoder(tmp_path: Path, change: dict, named: str) -> None:
    header = {"format": 1, "kind": "autoencoder", "feature_activation": "tanh", "metadata": {}} | change
    header = {name: value for name, value in header.items() if value is not None}
    save_file({"x": torch.zeros(1)}, tmp_path / "cae", {"header": json.dumps(header)})
    with pytest.raises(WeightsError, match=named):
        load_autoencoder(tmp_path / "cae")


@pytest.mark.parametrize(
    ("tensors", "named"),
    [
        ({"full": torch.zeros(500, 400)}, "large layer full is stored as torch.float32"),
        ({"full": torch.zeros(500, 400, dtype=torch.int8)}, "without a scale for each row"),
        (
            {"full": torch.zeros(4, 3, dtype=torch.int8), "full.row_scale": torch.ones(3)},
            "without a scale for each row",
        ),
    ],
)
def test_large_layers_come_in_8_bits_with_their_scales(tmp_path: Path, tensors: dict, named: str) -> None:
    header = {"format": 1, "kind": "autoencoder", "feature_activation": "tanh", "metadata": {}}
    save_file(tensors, tmp_path / "cae", {"header": json.dumps(header)})
    with pytest.raises(WeightsError, match=named):
        load_autoencoder(tmp_path / "cae")


def test_header_that_is_no_dictionary(tmp_path: Path) -> None:
    save_file({"x": torch.zeros(1)}, tmp_path / "p", {"header": "3"})
    with pytest.raises(WeightsError, match="damaged"):
        load_policy(tmp_path / "p")


def test_a_folder_is_no_weight_file(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="cannot be read"):
        file_hash(tmp_path)


def test_error_comes_back_from_another_process() -> None:
    error = WeightsError(Path("p"), "wrong", "Right it")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (WeightsError, str(error)) == (WeightsError, "p: wrong. Right it")


def test_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cae.safetensors"
    path.write_bytes(b"old")
    monkeypatch.setattr("models.files.tensors.save_file", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        save_autoencoder(path, ConvolutionalAutoencoder())
    assert path.read_bytes() == b"old"
