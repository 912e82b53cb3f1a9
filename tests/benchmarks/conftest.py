"""Fixtures: the whole closed loop on networks of the real size that learned nothing.

One thread, as everywhere at batch 1.
"""

import pytest
import torch

from models.inference import Encoder, Policy
from tests.diagrams.untrained import save_untrained


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="session")
def encoder(weights):
    return Encoder(weights / "encoder.onnx")


@pytest.fixture(scope="session")
def policy(weights):
    return Policy(weights / "lstm.onnx")
