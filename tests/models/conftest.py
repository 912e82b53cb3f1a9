"""Fixtures: one thread, a tiny synthetic data set, an autoencoder and a policy on it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from models.data.scaling import MinMaxScaling
from models.files.graphs import write_graph
from models.files.weights import StoredPolicy, save_autoencoder
from models.networks.cae import ConvolutionalAutoencoder, to_image
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn
from models.training.rnn import RnnOptions
from tests.models import handmade, synthetic


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def data_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp("data") / "tiny.h5", grid=2, ticks=(48, 52))


@pytest.fixture(scope="session")
def grown_data_file(data_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same data set after two more demonstrations were recorded; its content hash is the same."""
    path = tmp_path_factory.mktemp("grown") / "grown.h5"
    path.write_bytes(data_file.read_bytes())
    with h5py.File(path, "a") as file:
        for name, split in (("demo_8", "train"), ("demo_9", "valid")):
            file.copy("data/demo_0", f"data/{name}")
            names = [*file[f"mask/{split}"][()], name.encode()]
            del file[f"mask/{split}"]
            file[f"mask/{split}"] = np.array(names, "S")
    return path


@pytest.fixture(scope="session")
def rnn_options(data_file: Path, encoder_file: Path) -> RnnOptions:
    """Four updates of a small network from outside; `out` is for the test to choose."""
    return RnnOptions(
        data=data_file,
        encoder=encoder_file,
        out=data_file.parent,
        features=data_file.with_name("features.npz"),  # encoded once
        rnn="tests.models.outside:Elman",
        steps=4,
        posture_weight=4.0,
        learning_rate=0.01,
        batch_size=4,
        checkpoint_every=2,
        validate_every=2,
    )


@pytest.fixture(scope="session")
def pictures() -> np.ndarray:
    """Random pictures, uint8 (4, 112, 112, 3)."""
    return np.random.default_rng(3).integers(0, 256, (4, 112, 112, 3), np.uint8)


@pytest.fixture(scope="session")
def autoencoder_file(tmp_path_factory: pytest.TempPathFactory, pictures: np.ndarray) -> Path:
    """An untrained autoencoder whose batch norm has seen pictures."""
    torch.manual_seed(5)
    model = ConvolutionalAutoencoder()
    for module in model.modules():
        if hasattr(module, "momentum"):
            module.momentum = 1.0
    with torch.no_grad():
        model.decode(model.train().encode(to_image(torch.from_numpy(pictures))))
    path = tmp_path_factory.mktemp("autoencoder") / "cae.safetensors"
    save_autoencoder(path, model, {"data_hash": "abc"})
    return path


@pytest.fixture(scope="session")
def encoder_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An encoder that was put together by hand."""
    path = tmp_path_factory.mktemp("encoder") / "encoder.onnx"
    write_graph(path, handmade.encoder().SerializeToString(), {"kind": "encoder", "metadata": {}})
    return path


def make_policy(name: str = "lstm", recall: bool = True) -> StoredPolicy:
    torch.manual_seed(1)
    rnn = make_rnn(name)
    return StoredPolicy(
        rnn=rnn,
        name=rnn.name,
        recall=RecallHeads(rnn.state_size, 8) if recall else None,
        scaling=MinMaxScaling(-np.arange(1.0, 9.0), np.arange(2.0, 10.0)),
        initial_posture=synthetic.INITIAL_POSTURE,
        encoder_hash="e" * 64,
        metadata={"training": {"seed": 0}},
    )
