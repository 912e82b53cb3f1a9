"""What the explorer shows of an episode, tick by tick: a script that its page loads, and what the camera saw."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from diagrams.episodes.record import PICTURE_EVERY, Record, record_hash
from models.errors import InputError

SHOWN = "explorer"  # folder in --out; entry of a row that is no part of it: the files there, by suffix
TRACE, PICTURES = ".js", ".webp"  # suffixes of these, after the episode's key
PICTURE_COLUMNS = 10  # in a line of the file
QUALITY = 80  # of the pictures: 1 to 2 kB each
LEAST = 1e-6  # a score that is smaller is drawn as this


def trace_script(
    key: str, record: Record, acting: Sequence[bool], scores: Mapping[str, np.ndarray], alpha: np.ndarray | None = None
) -> bytes:
    """Calls `episode(key, trace)`; the trace in plain types, numbers rounded to what can be seen.

    Args:
        acting: (T,) whether the fault, or the disturbance, is under way.
        scores: of each detector by its label, (T,) the largest error by its mean.
        alpha: (T,) in the loop; None: the detector was off.
    """
    trace: dict[str, Any] = {"hash": run_hash(record), "ticks": len(record.time), "acting": spans(acting)}
    trace |= {"events": [[round(seconds, 3), what] for seconds, what in record.events]}
    count = -(-len(record.time) // PICTURE_EVERY)
    trace |= {"pictures": {"count": count, "columns": PICTURE_COLUMNS, "every": PICTURE_EVERY}}
    trace |= {"scores": {label: [_rounded(v) for v in values] for label, values in scores.items()}}
    if alpha is not None:
        trace["alpha"] = [round(float(v), 3) for v in alpha]
    return f"episode({json.dumps(key)}, {json.dumps(trace, separators=(',', ':'))});\n".encode()


def run_hash(record: Record) -> str:
    """Says which run it is, to the bit."""
    return record_hash(record)[:16]


def kept_trace(bench: Path, key: str) -> bytes:
    """The `trace_script` of the episode `key` in the folder `bench`; raises InputError where there is none."""
    path = bench / SHOWN / f"{key}{TRACE}"
    if not path.is_file():
        raise InputError(f"there is no {path}: run the command of the bench again")
    return path.read_bytes()


def require_same_run(script: bytes, record: Record, bench: Path, key: str) -> None:
    """Raises InputError where the `script` of the episode `key` in `bench` is not of this run, to the bit."""
    if f'"hash":"{run_hash(record)}"'.encode() not in script:
        raise InputError(f"{key} runs otherwise now than in {bench}: take the version of the program that made it")


def spans(active: Sequence[bool]) -> list[list[int]]:
    """The stretches of (T,), each by its first tick and the first one after it."""
    edges = np.flatnonzero(np.diff(np.asarray(active, int), prepend=0, append=0))
    return edges.reshape(-1, 2).tolist()


def _rounded(value: float) -> float:
    return float(f"{max(float(value), LEAST):.3g}")


def pictures_file(record: Record) -> bytes:
    """The content of a .webp: what the camera saw, line by line, PICTURE_COLUMNS in each, black after the last."""
    count, (height, width) = len(record.pictures), record.pictures.shape[1:3]
    lines = -(-count // PICTURE_COLUMNS)
    sheet = np.zeros((lines * PICTURE_COLUMNS, height, width, 3), np.uint8)
    sheet[:count] = record.pictures
    whole = sheet.reshape(lines, PICTURE_COLUMNS, height, width, 3).swapaxes(1, 2)
    file = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(whole).reshape(lines * height, PICTURE_COLUMNS * width, 3))
    image.save(file, "WEBP", quality=QUALITY, method=4)
    return file.getvalue()
