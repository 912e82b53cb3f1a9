"""Fixtures of the analyses."""

import pytest

from models.files.weights import load_policy
from tests.diagrams.untrained import save_untrained


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """A policy that learned nothing."""
    return load_policy(save_untrained(tmp_path_factory.mktemp("weights")) / "lstm.onnx")
