"""The encoder is read once a module: its file is large."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from models.inference import Encoder


@pytest.fixture(autouse=True, scope="module")
def encoder_read_once(encoder_file: Path) -> Iterator[None]:
    encoder = Encoder(encoder_file)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("rnn", "recall"):
            patch.setattr(f"models.training.{module}.Encoder", lambda path: encoder)
        yield
