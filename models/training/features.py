"""Features of a whole data set, kept in a file for the trainings that need them."""

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from models.data.demonstrations import content_of, iterate_frames, read_demonstrations
from models.errors import InputError
from models.files.container import whole_file


def encode_dataset(path: Path, encoder: Any, cache: Path) -> dict[str, np.ndarray]:
    """Features (T, 30) of every demonstration by name; from `cache` if it was made of these data by this encoder.

    `encoder`: see models/inference.py: `hash` and `encode_batch`.

    Raises InputError if `cache` is a file of another kind, or a damaged one: it is not overwritten.
    """
    names = [demo.name for demo in read_demonstrations(path)]
    key = f"{encoder.hash} {content_of(path)}"
    if cache.exists():
        try:
            with np.load(cache) as stored:
                if str(stored["key"]) == key:
                    return {name: stored[name] for name in names}
        except Exception as error:  # whatever reading strange bytes may raise
            raise InputError(
                f"{cache}: not a whole file of features ({type(error).__name__}): delete it, or give another --features"
            ) from error
    frames = tqdm(iterate_frames(path, names), total=len(names), desc="encoding", unit="demonstration", disable=None)
    features = {name: encoder.encode_batch(rgb) for name, rgb in zip(names, frames, strict=True)}
    with whole_file(cache) as partial, partial.open("wb") as file:  # other trainings may write the same file
        np.savez(file, allow_pickle=False, key=np.array(key), **features)
    return features
