import zipfile
from pathlib import Path

import numpy as np
import pytest

from models.errors import InputError
from models.inference import Encoder
from models.training.features import encode_dataset


class Counting(Encoder):
    """Counts what it encodes, and encodes fast: every feature is the demonstration's number of pictures."""

    calls = 0

    def encode_batch(self, rgb: np.ndarray, batch: int = 64) -> np.ndarray:
        self.calls += 1
        return np.full((len(rgb), 30), float(len(rgb)))


@pytest.fixture(scope="module")
def encoder(encoder_file: Path) -> Counting:
    return Counting(encoder_file)


def test_features_are_made_once(data_file: Path, encoder: Counting, tmp_path: Path) -> None:
    encoder.calls = 0
    made = encode_dataset(data_file, encoder, tmp_path / "f.npz")
    assert (encoder.calls, sorted(made)) == (8, [f"demo_{i}" for i in range(8)])
    again = encode_dataset(data_file, encoder, tmp_path / "f.npz")
    assert encoder.calls == 8
    assert all(np.array_equal(made[name], again[name]) for name in made)
    assert [path.name for path in tmp_path.iterdir()] == ["f.npz"]


def test_other_demonstrations_under_the_same_content_hash_are_encoded_anew(
    data_file: Path, grown_data_file: Path, encoder: Counting, tmp_path: Path
) -> None:
    encode_dataset(data_file, encoder, tmp_path / "f.npz")
    encoder.calls = 0
    assert len(encode_dataset(grown_data_file, encoder, tmp_path / "f.npz")) == encoder.calls == 10


@pytest.mark.parametrize("damage", ["empty", "cut", "text", "foreign"])
def test_damaged_features_are_named_and_kept(data_file: Path, encoder: Counting, tmp_path: Path, damage: str) -> None:
    cache = tmp_path / "f.npz"
    encode_dataset(data_file, encoder, cache)
    whole = cache.read_bytes()
    cache.write_bytes({"empty": b"", "cut": whole[: len(whole) // 2], "text": b"words", "foreign": b""}[damage])
    if damage == "foreign":
        with zipfile.ZipFile(cache, "w") as file:
            file.writestr("readme.txt", "mine")
    content = cache.read_bytes()
    with pytest.raises(InputError, match=r"f\.npz: not a whole file of features .*delete it"):
        encode_dataset(data_file, encoder, cache)
    assert cache.read_bytes() == content
