"""The record of a run: every tick, some pictures, and the file that keeps them."""

import dataclasses
import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagrams.episodes.episode import Outcome
from models.errors import InputError
from models.files.container import write_bytes

PICTURE_EVERY = 5  # ticks between two pictures in a record's file
_REMEDY = "write one with `pick_place.py --record FILE.npz`"


@dataclass
class Record:
    """One run, a row a tick (taken in the middle of the tick); angles rad, lengths m."""

    time: np.ndarray  # (n,) s, of the tick
    posture: np.ndarray  # (n, 8) m_k as sampled: seven joints, rad, and the commanded finger opening, m
    rnn_step: np.ndarray  # (n, 8) dm^R, rad and m a tick
    regulator_step: np.ndarray  # (n, 8) dm^L, rad and m a tick
    desired_posture: np.ndarray  # (n, 8) command, rad and m
    alpha: np.ndarray  # (n,) in [0, 1]
    errors: np.ndarray  # (n, E) of the detector; of the recall, l_n / mean_l_n
    hidden_state: np.ndarray  # (n, S) c_k, no unit
    network_input: np.ndarray  # (n, 38) x_k, scaled: posture and features for the network, where it did not start anew
    predicted_features: np.ndarray  # (n, 30) f^R_{k+1}, in [-1, 1]
    active: np.ndarray  # (n,) 1 while the disturbance is under way, else 0
    can_poses: np.ndarray  # (n, 14) of the can to pick, then of the other: quaternion w, x, y, z and position, m, world
    signals: np.ndarray  # (n, 7) that the requirements look at, see world/requirement_signals.py
    tick_seconds: np.ndarray  # (n,) s of the wall clock that the tick took, scoring and pictures included
    picture_ticks: np.ndarray  # (p,) ticks of the pictures; none where they were not asked for
    pictures: np.ndarray  # (p, 112, 112, 3) uint8, what the camera saw
    events: list[tuple[float, str]]  # (s, what happened)


_WIDTHS = dict.fromkeys(("posture", "rnn_step", "regulator_step", "desired_posture"), 8) | {"can_poses": 14}
# What is read of an outcome, and its types.
_OUTCOME: dict[str, tuple[type, ...]] = {
    "seed": (int,), "disturbance": (str,), "detector": (str,), "weights_hash": (str,), "success": (bool, type(None)),
    "switch_success": (bool, type(None)), "failure": (str, type(None)),
}  # fmt: skip
ARRAYS = tuple(f.name for f in dataclasses.fields(Record) if f.name != "events")
FLAT = ("time", "alpha", "active", "tick_seconds", "picture_ticks")  # arrays of one axis


def record_hash(record: Record) -> str:
    """SHA-256 (hexadecimal) over every number of the run but its pictures: equal for two runs that agree bit by bit.

    What its ticks took of the wall clock is none of its numbers.
    """
    total = hashlib.sha256()
    for name in ARRAYS:
        if "picture" not in name and name != "tick_seconds":
            array = getattr(record, name)
            total.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
    return total.hexdigest()


def stretches(record: Record) -> tuple[slice, slice]:
    """Ticks before the onset, and from it to the end of the disturbance; undisturbed: all, and none."""
    active = record.active > 0.5
    onset = int(np.argmax(active)) if active.any() else len(active)
    return slice(0, onset), slice(onset, onset + int(active.sum()))


def record_bytes(record: Record, outcome: Outcome) -> bytes:
    """The content of a record file (.npz); of pictures that were taken more often, those every PICTURE_EVERY ticks."""
    kept = record.picture_ticks % PICTURE_EVERY == 0
    if not kept.all():
        record = dataclasses.replace(record, picture_ticks=record.picture_ticks[kept], pictures=record.pictures[kept])
    text, file = json.dumps({"events": record.events, "outcome": outcome.to_dict()}), io.BytesIO()
    np.savez_compressed(file, text=np.array(text), **{name: getattr(record, name) for name in ARRAYS})
    return file.getvalue()


def save_record(path: Path, record: Record, outcome: Outcome) -> None:
    """Writes `record` and `outcome` to `path` (.npz)."""
    write_bytes(path, record_bytes(record, outcome))


def load_record(path: Path) -> tuple[Record, dict]:
    """The record in `path`, and its outcome as a dictionary (see Outcome); raises InputError where there is none."""
    if not path.is_file():
        raise InputError(f"there is no record {path}: {_REMEDY}")
    try:
        with np.load(path, allow_pickle=False) as file:
            text = json.loads(str(file["text"]))
            arrays = {name: file[name] for name in ARRAYS}
        record = Record(**arrays, events=[(float(t), str(what)) for t, what in text["events"]])
        _require_whole(record, text["outcome"])
        return record, text["outcome"]
    except Exception as error:  # numpy, zip, zlib and json raise a dozen types, with words of their own
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path} holds no record, or a damaged one ({reason}): {_REMEDY}") from error


def _require_whole(record: Record, outcome: dict) -> None:
    """Raises ValueError unless the arrays are rows of one run, of finite numbers, and the outcome is one."""
    ticks, shots = len(record.time), len(record.picture_ticks)
    for name in ARRAYS:
        array = getattr(record, name)
        rows = shots if "picture" in name else ticks
        kinds = "u" if name == "pictures" else "iu" if name == "picture_ticks" else "fiub"
        axes = {"pictures": 4}.get(name, 1 if name in FLAT else 2)
        fits = array.ndim == axes or (name == "pictures" and not shots)
        if not fits or len(array) != rows or array.dtype.kind not in kinds or not np.isfinite(array).all():
            raise ValueError(f"{name} is {array.dtype} {array.shape} of {ticks} ticks: finite rows are needed")
        if (name in _WIDTHS and array.shape[1] != _WIDTHS[name]) or np.abs(array).max(initial=0) > 1e15:
            raise ValueError(f"{name} is {array.shape} of numbers up to {np.abs(array).max(initial=0):g}")
    if not ticks or np.any(np.diff(record.time) <= 0) or np.any((record.alpha < 0) | (record.alpha > 1)):
        raise ValueError("it has no ticks, or time or alpha are none")
    if shots and not (np.all(record.picture_ticks >= 0) and np.all(record.picture_ticks < ticks)):
        raise ValueError(f"picture_ticks are beyond the {ticks} ticks")
    if not all(np.isfinite(seconds) for seconds, _ in record.events):
        raise ValueError("an event has no time")
    if absent := [name for name in _OUTCOME if name not in outcome]:
        raise ValueError(f"the outcome has no {', '.join(absent)}")
    for name, types in _OUTCOME.items():
        if not isinstance(outcome[name], types):
            raise ValueError(f"the outcome has the {name} {outcome[name]!s:.60}")


def find_records(paths: list[Path]) -> list[Path]:
    """`paths`, folders replaced by the .npz files in them; raises InputError for an empty folder."""
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.npz")) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"there is no record (.npz) in the folder {path}: {_REMEDY}")
        found += inside
    return found
