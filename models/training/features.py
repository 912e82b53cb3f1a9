"""Features of a whole data set, kept in a file for the trainings that need them."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from models.checks import require_plain
from models.data.demonstrations import content_of, iterate_frames, read_demonstrations
from models.errors import InputError


def _checked(features: np.ndarray, ticks: int) -> np.ndarray:
    """Raises ValueError unless they are finite numbers, a row a tick."""
    if features.ndim != 2 or features.dtype.kind != "f" or len(features) != ticks or not np.isfinite(features).all():
        raise ValueError(f"features {features.dtype} {features.shape}, where {ticks} rows of finite numbers are needed")
    return features


def encode_dataset(path: Path, encoder: Any, cache: Path) -> dict[str, np.ndarray]:
    """Features (T, 30) of every demonstration by name; from `cache` if it was made of these data by this encoder.

    `encoder`: see models/inference.py: `hash` and `encode_batch`.

    Raises InputError if `cache` is a file of another kind, or a damaged one: it is not overwritten.
    """
    lengths = {demo.name: len(demo.posture) for demo in read_demonstrations(path)}
    names = list(lengths)
    key = f"{encoder.hash} {content_of(path)}"
    require_plain(cache, "give another --features")
    if cache.exists():
        try:
            with np.load(cache) as stored:
                if str(stored["key"]) == key:
                    found = {name: _checked(stored[name], ticks) for name, ticks in lengths.items()}
                    if len(widths := {array.shape[1] for array in found.values()}) > 1:
                        raise ValueError(f"features of several sizes, {sorted(widths)}")
                    return found
        except Exception as error:  # whatever reading strange bytes may raise
            words = f"{type(error).__name__}: {' '.join(str(error).split()):.200}"
            raise InputError(
                f"{cache}: not a whole file of features ({words}): delete it, or give another --features"
            ) from error
    frames = tqdm(iterate_frames(path, names), total=len(names), desc="encoding", unit="demonstration", disable=None)
    features = {name: encoder.encode_batch(rgb) for name, rgb in zip(names, frames, strict=True)}
    cache.parent.mkdir(parents=True, exist_ok=True)
    partial = cache.with_name(f"{cache.stem}.{os.getpid()}.npz")  # other trainings may write the same file
    np.savez(partial, allow_pickle=False, key=np.array(key), **features)
    os.replace(partial, cache)
    return features
