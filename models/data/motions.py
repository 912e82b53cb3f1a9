"""Reads what anybody's arm did: runs of states and actions, from robomimic's HDF5 or a LeRobotDataset v3."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from models.checks import require_plain
from models.data.demonstrations import MOST_TICKS, hdf5_errors, require_whole
from models.errors import InputError

STATE = "observation.state"  # of LeRobot
ACTIONS = ("action", "actions")  # of LeRobot, and of many who convert to it
POSTURE = "posture"  # of ours, in HDF5
MOST = 10**7  # numbers in an array of a run


@dataclass(frozen=True)
class Motion:
    """A run of an arm, a row a tick.

    Attributes:
        name: of the file, and of the run in it.
        states: (T, M) measured, in the unit of whoever recorded it.
        actions: (T, A) commanded.
        success: whether the task was done; None: the file does not say.
        period: s, of the ticks; None: the file does not say.
    """

    name: str
    states: np.ndarray
    actions: np.ndarray
    success: bool | None
    period: float | None


def read_motions(path: Path, states: Sequence[str] = ()) -> list[Motion]:
    """All runs of a LeRobotDataset, a folder, or of a robomimic file.

    `states`: names of the observations that make a state, side by side; none: observation.state, and posture. Whether a
    run did its task says `success`, of the episode, else next.success or a reward above 0 in some tick; a dense reward
    (robomimic's reward_shaping) does not.

    Raises InputError where there is none, or one without these numbers.
    """
    if path.is_dir():
        found = list(_of_lerobot(path, states or [STATE]))
    else:
        found = list(_of_robomimic(path, states or [POSTURE]))
    if not found:
        raise InputError(f"{path} holds no run: give another --data")
    for motion in found:
        for what, array in (("states", motion.states), ("actions", motion.actions)):
            if array.ndim != 2 or not array.size or len(array) != len(motion.actions) or not np.isfinite(array).all():
                raise InputError(
                    f"{motion.name} has {what} {array.shape} that are no finite rows of its ticks: leave it out"
                )
    return found


def _of_robomimic(path: Path, states: Sequence[str]) -> Iterator[Motion]:
    require_plain(path, "give another --data")
    if not path.exists():
        raise InputError(f"there is no file {path}: give another --data")
    with hdf5_errors(path, "read", "give another --data", "give another --data"), h5py.File(path, "r") as file:
        require_whole(path, file)
        data: Any = file["data"]
        period, shaped = _environment(data.attrs)
        for name in sorted(data, key=lambda name: (len(name), name)):
            group = data[name]
            if "obs" not in group:
                raise InputError(f"{path}: {name} has no observations: let robomimic extract them from its states")
            if absent := [state for state in states if state not in group["obs"]]:
                raise InputError(
                    f"{path}: {name} has no observation {', '.join(absent)}: choose from {', '.join(group['obs'])} by "
                    "--state"
                )
            parts = [_array(group["obs"][state]) for state in states]
            success = group.attrs.get("success")
            if success is None and "rewards" in group and not shaped:
                success = np.any(_array(group["rewards"]) > 0.0)
            yield Motion(
                f"{path.name}/{name}", np.hstack([part.reshape(len(part), -1) for part in parts]),
                _array(group["actions"]), None if success is None else bool(success), period,
            )  # fmt: skip


def _array(dataset: h5py.Dataset) -> np.ndarray:
    """Its numbers; a file of some bytes may claim any number of them."""
    if dataset.size > MOST or max(dataset.shape, default=0) > MOST_TICKS:
        raise InputError(
            f"{dataset.file.filename}: {dataset.name} has the shape {dataset.shape}, more than {MOST_TICKS} ticks or "
            f"{MOST} numbers: leave that run out"
        )
    return np.asarray(dataset, float)


def _environment(attributes: Any) -> tuple[float | None, bool]:
    """The period of the ticks, s: ours is said, robomimic's have a frequency; and whether the reward is dense."""
    made = json.loads(attributes.get("env_args", "{}")).get("env_kwargs") or {}
    frequency = made.get("control_freq")
    period = attributes.get("period", None if frequency is None else 1.0 / float(frequency))
    return None if period is None else float(period), bool(made.get("reward_shaping"))


def _of_lerobot(path: Path, states: Sequence[str]) -> Iterator[Motion]:
    import pandas as pd
    import pyarrow.parquet as pq

    try:
        info = json.loads((path / "meta" / "info.json").read_text())
        if info["codebase_version"] != "v3.0":
            raise InputError(f"{path} is LeRobot's {info['codebase_version']}: convert it to v3.0")
        period, known = 1.0 / float(info["fps"]), info["features"]
        action = next((name for name in ACTIONS if name in known), ACTIONS[0])
        if absent := [name for name in (*states, action) if name not in known]:
            raise InputError(f"{path} has no {', '.join(absent)}: choose from {', '.join(known)} by --state")
        success = dict[int, Any]()
        for file in sorted((path / "meta" / "episodes").rglob("*.parquet")):
            if "success" in pq.read_schema(file).names:
                said = pq.read_table(file, columns=["episode_index", "success"]).to_pylist()
                success |= {row["episode_index"]: row["success"] for row in said}
        columns = [*states, action, "episode_index", *(name for name in ("next.success",) if name in known)]
        parts = [pd.read_parquet(file, columns=columns) for file in sorted((path / "data").rglob("*.parquet"))]
        for index, rows in pd.concat(parts).groupby("episode_index"):
            done = success.get(index)
            if done is None and "next.success" in rows:
                done = np.any(np.stack(rows["next.success"].to_list()))
            arrays = [np.stack(rows[name].to_list()).astype(float).reshape(len(rows), -1) for name in (*states, action)]
            name = f"{path.name}/episode_{index}"
            yield Motion(name, np.hstack(arrays[:-1]), arrays[-1], None if done is None else bool(done), period)
    except InputError:
        raise
    # pyarrow's errors are among these
    except (OSError, KeyError, RecursionError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        words = " ".join(str(error).split())[:200]
        raise InputError(f"{path} is no LeRobotDataset, or a damaged one ({words}): give another --data") from error
