"""Fixtures: one thread, a tiny synthetic data set, an autoencoder and a policy on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from models.data.scaling import MinMaxScaling
from models.files.weights import StoredPolicy, save_autoencoder
from models.networks.cae import ConvolutionalAutoencoder, to_image
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn
from tests.models import synthetic


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def data_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp("data") / "tiny.h5", grid=2, ticks=(48, 52))


@pytest.fixture(scope="session")
def pictures() -> np.ndarray:
    """Random pictures, uint8 (4, 112, 112, 3)."""
    return np.random.default_rng(3).integers(0, 256, (4, 112, 112, 3), np.uint8)


@pytest.fixture(scope="session")
def encoder_file(tmp_path_factory: pytest.TempPathFactory, pictures: np.ndarray) -> Path:
    """An untrained autoencoder whose batch norm has seen pictures."""
    torch.manual_seed(5)
    model = ConvolutionalAutoencoder()
    for module in model.modules():
        if hasattr(module, "momentum"):
            module.momentum = 1.0
    with torch.no_grad():
        model.train()(to_image(torch.from_numpy(pictures)))
    path = tmp_path_factory.mktemp("weights") / "cae.safetensors"
    save_autoencoder(path, model, {"data_hash": "abc"})
    return path


def make_policy(name: str = "lstm", recall: bool = True) -> StoredPolicy:
    torch.manual_seed(1)
    rnn = make_rnn(name)
    return StoredPolicy(
        rnn=rnn,
        recall=RecallHeads(rnn.state_size, 8) if recall else None,
        scaling=MinMaxScaling(-np.arange(1.0, 9.0), np.arange(2.0, 10.0)),
        initial_posture=synthetic.INITIAL_POSTURE,
        regulator_gain=0.1,
        encoder_hash="e" * 64,
        metadata={"training": {"seed": 0}},
    )
