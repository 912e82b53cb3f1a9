"""Writes demonstrations, and other runs, as a LeRobotDataset v3.0: a folder of Parquet, MP4 and JSON files.

    meta/info.json, meta/stats.json, meta/tasks.parquet, meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-N.parquet, videos/observation.images.camera/chunk-000/file-N.mp4: of demonstration N

The columns of an episode beside LeRobot's: its attributes, as in the robomimic layout (models/data/recording.py).
Pictures are compressed (H.264), numbers are float32; further arrays of a run are observation.NAME.
"""

import hashlib
import json
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.data.demonstrations import number_of
from models.data.recording import RecordedRun, Recording, digest_of
from models.errors import InputError
from models.files.container import locked, whole_file, write_bytes

CAMERA = "observation.images.camera"
VERSION, CHUNK = "v3.0", 1000  # files in a folder
SETTINGS = "meta/hindsight.json"  # what decides the content, and the attributes of the whole file of the other layout
TASKS = {spot: f"Pick the can and place it on the {spot} spot of the shelf." for spot in ("left", "right")}
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
# Every second picture is whole: any is found fast. One thread, and no look ahead: the same bytes each time (with x264's
# look ahead 23 of 3,600 files were others, without it none of as many).
CODEC, CODEC_OPTIONS = "libx264", {
    "crf": "12", "g": "2", "bf": "0", "threads": "1", "x264-params": "mbtree=0:rc-lookahead=0",
}  # fmt: skip
_PLACES = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_NUMBERS = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64"}
_NUMBERS |= {"task_index": "int64"}


class LeRobotFolder(AbstractContextManager):
    """A data set to which demonstrations are added; a context manager with the face of RecordingFile.

    An unfinished one is completed: a demonstration counts once its Parquet file, written last, is there.
    """

    def __init__(self, path: Path, settings: dict[str, Any], attributes: dict[str, Any]):
        """Opens or begins the folder; see RecordingFile. `attributes` have `period` (s), `posture_names` and `world`
        (JSON; its models name the robot); `names`, if it is there, names the components of further arrays, by array.

        Raises InputError where it cannot be written, is anything else, or was recorded with other settings.
        """
        self._held = ExitStack()
        self._path, self._attributes = path, {k: np.asarray(v).tolist() for k, v in attributes.items()}
        self._names = json.loads(attributes["posture_names"])
        self._further_names = {f"observation.{key}": n for key, n in json.loads(attributes.get("names", "{}")).items()}
        self._robot = json.loads(attributes["world"])["models"].partition(".")[0]
        self._fps = round(1.0 / attributes["period"])
        if not np.isclose(self._fps * attributes["period"], 1.0, rtol=0.0, atol=1e-9):
            raise InputError(
                f"a period of {attributes['period']} s is no whole number of pictures a second, which LeRobot counts: "
                "choose such a period, or --format robomimic"
            )
        kept, text = path / SETTINGS, json.loads(json.dumps(settings))
        try:
            if path.exists() and not kept.is_file() and (not path.is_dir() or any(path.iterdir())):
                raise InputError(f"{path} is no data set of this program: choose another --out")
            if kept.is_file():
                found = json.loads(kept.read_text())["settings"]
                if others := [name for name, value in text.items() if found.get(name) != value]:
                    words = " and another ".join(others)
                    raise InputError(f"{path} was recorded with another {words}: delete it, or choose another --out")
            self._held.enter_context(locked(kept.with_suffix(".lock")))
            write_bytes(kept, json.dumps({"settings": text, "attributes": self._attributes}, indent=1).encode())
        except OSError as error:
            raise InputError(f"{path} cannot be written ({error.strerror}): choose another --out") from error
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{kept} is damaged ({error}): delete {path}, or choose another --out") from error

    def __exit__(self, kind: object = None, error: BaseException | None = None, trace: object = None) -> None:
        self._held.close()
        if isinstance(error, KeyboardInterrupt | OSError):
            error.add_note(f"{self._path} keeps what was finished: the same command goes on")

    def __contains__(self, name: str) -> bool:
        return self._data(number_of(name)).is_file() and self._video(number_of(name)).is_file()

    def add(self, recording: Recording | RecordedRun) -> None:
        """Writes one demonstration; it is whole on the disk when this returns."""
        number = number_of(recording.name)
        self._encode(self._video(number), recording.rgb)
        ticks = np.arange(len(recording.actions))
        columns = {
            "observation.state": _rows(recording.posture), "action": _rows(recording.actions),
            "timestamp": pa.array(ticks / self._fps, pa.float32()), "frame_index": pa.array(ticks),
            "episode_index": pa.array(np.full_like(ticks, number)), "index": pa.array(number * len(ticks) + ticks),
            "task_index": pa.array(np.full_like(ticks, list(TASKS).index(recording.vacant))),
        }  # fmt: skip
        columns |= {f"observation.{name}": _rows(array) for name, array in recording.further.items()}
        notes = {name: np.asarray(value).tolist() for name, value in recording.attributes.items()}
        notes["content"] = digest_of(recording)
        # What the statistics need of the pictures: how often each channel has each value.
        counts = [np.bincount(recording.rgb[..., c].ravel(), minlength=256).tolist() for c in range(3)]
        table = pa.table(columns).replace_schema_metadata({"hindsight": json.dumps(notes | {"counts": counts})})
        self._write_table(self._data(number), table)

    def finish(self, names: Sequence[str]) -> tuple[str, list[str]]:
        """Writes what LeRobot reads first; returns the content hash, and the names of those that failed."""
        import pandas as pd

        digest, failed, rows, first = hashlib.sha256(), list[str](), list[dict[str, Any]](), 0
        values: dict[str, list[np.ndarray]] = {}
        counts = np.zeros((3, 256), np.int64)
        wanted = {path for number in map(number_of, names) for path in (self._data(number), self._video(number))}
        # LeRobot counts the files of a folder, not those that are named; a part is of a run that was killed.
        found = {path for part in ("data", "videos") for path in (self._path / part).rglob("*") if path.is_file()}
        surplus = found - wanted
        if others := sum(path.suffix == ".parquet" for path in surplus):
            raise InputError(
                f"{self._path} has {others} demonstrations beyond the {len(names)} that are asked for: ask for them "
                "too, or choose another --out"
            )
        for path in surplus:
            path.unlink()
        for number, name in enumerate(sorted(names, key=number_of)):
            path = self._data(number_of(name))
            try:
                table = pq.read_table(path)
                notes = json.loads(table.schema.metadata[b"hindsight"])
            # pyarrow's errors are among these
            except (OSError, KeyError, RecursionError, TypeError, ValueError) as error:
                words = " ".join(str(error).split())
                raise InputError(f"{path} is damaged ({words}): delete it, and record once more") from error
            own, length = np.array(notes.pop("counts")), table.num_rows
            if table["index"][0].as_py() != first:  # those before are not of one length
                place = table.schema.get_field_index("index")
                table = table.set_column(place, "index", pa.array(first + np.arange(length)))
                self._write_table(path, table)
            arrays = {key: _array(table[key]) for key in table.column_names}
            stats = {key: _statistics(array) for key, array in arrays.items()} | {CAMERA: _of_pictures(own, length)}
            digest.update(f"{name} {notes.pop('content')}".encode())
            failed += [] if notes["success"] else [name]
            chunk, file = divmod(number_of(name), CHUNK)
            rows.append(
                {
                    "episode_index": number, "tasks": [TASKS[notes["vacant"]]], "length": length,
                    "data/chunk_index": chunk, "data/file_index": file,
                    "dataset_from_index": first, "dataset_to_index": first + length,
                    f"videos/{CAMERA}/chunk_index": chunk, f"videos/{CAMERA}/file_index": file,
                    f"videos/{CAMERA}/from_timestamp": 0.0, f"videos/{CAMERA}/to_timestamp": length / self._fps,
                    "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
                }
                | {f"stats/{key}/{name}": value for key, found in stats.items() for name, value in found.items()}
                | notes
            )  # fmt: skip
            first, counts = first + length, counts + own
            for key, array in arrays.items():
                values.setdefault(key, []).append(array)
        episodes = "meta/episodes/" + _PLACES.format(chunk_index=0, file_index=0)
        self._write_table(self._path / f"{episodes}.parquet", pa.Table.from_pylist(rows))
        tasks = pd.DataFrame({"task_index": range(len(TASKS))}, index=list(TASKS.values()))
        self._write_table(self._path / "meta" / "tasks.parquet", pa.Table.from_pandas(tasks))
        whole = {key: _statistics(np.concatenate(parts)) for key, parts in values.items()}
        whole[CAMERA] = _of_pictures(counts, first)
        write_bytes(self._path / "meta" / "stats.json", json.dumps(whole, indent=1).encode())
        content = digest.hexdigest()
        sizes = {key: parts[0].shape[1] for key, parts in values.items() if key not in _NUMBERS}
        info = self._info(self._video(min(map(number_of, names))), len(rows), first, sizes) | {"content_hash": content}
        write_bytes(self._path / "meta" / "info.json", json.dumps(info, indent=1).encode())
        return content, failed

    def _info(self, video_path: Path, episodes: int, frames: int, sizes: dict[str, int]) -> dict[str, Any]:
        """`sizes`: components of each array."""
        import av

        with av.open(str(video_path)) as container:
            stream = container.streams.video[0]
            height, width, codec, pixels = stream.height, stream.width, stream.codec.canonical_name, stream.pix_fmt
        video = {"video.height": height, "video.width": width, "video.codec": codec, "video.pix_fmt": pixels}
        video |= {"video.is_depth_map": False, "video.fps": self._fps, "video.channels": 3, "has_audio": False}
        shape = [height, width, 3]
        features: dict[str, dict[str, Any]] = {
            CAMERA: {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"], "info": video}
        }
        named = self._further_names | dict.fromkeys(("observation.state", "action"), self._names)
        for key, size in sizes.items():
            features[key] = {"dtype": "float32", "shape": [size], "names": named.get(key)}
        features |= {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in _NUMBERS.items()}
        return {
            "codebase_version": VERSION, "robot_type": self._robot, "total_episodes": episodes, "total_frames": frames,
            "total_tasks": len(TASKS), "chunks_size": CHUNK, "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200, "fps": self._fps, "splits": {"train": f"0:{episodes}"},
            "data_path": f"data/{_PLACES}.parquet", "video_path": f"videos/{{video_key}}/{_PLACES}.mp4",
            "features": features,
        }  # fmt: skip

    def _encode(self, path: Path, pictures: np.ndarray) -> None:
        import av

        with whole_file(path) as partial, av.open(str(partial), "w") as container:
            stream: Any = container.add_stream(CODEC, rate=self._fps, options=CODEC_OPTIONS)
            stream.height, stream.width, stream.pix_fmt = *pictures.shape[1:3], "yuv420p"
            for picture in pictures:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")))
            container.mux(stream.encode())

    def _write_table(self, path: Path, table: pa.Table) -> None:
        with whole_file(path) as partial:
            pq.write_table(table, partial)

    def _data(self, number: int) -> Path:
        chunk, file = divmod(number, CHUNK)
        return self._path / "data" / (_PLACES.format(chunk_index=chunk, file_index=file) + ".parquet")

    def _video(self, number: int) -> Path:
        chunk, file = divmod(number, CHUNK)
        return self._path / "videos" / CAMERA / (_PLACES.format(chunk_index=chunk, file_index=file) + ".mp4")


def _rows(array: np.ndarray) -> pa.Array:
    """(T, n) as a column of lists of n float32; of n = 1, as LeRobot has it, of numbers."""
    if array.shape[1] == 1:
        return pa.array(array[:, 0], pa.float32())
    return pa.FixedSizeListArray.from_arrays(pa.array(array.ravel(), pa.float32()), array.shape[1])


def _array(column: pa.ChunkedArray) -> np.ndarray:
    """A column as (T, n), or (T, 1)."""
    flat = column.combine_chunks()
    values = flat.flatten() if pa.types.is_fixed_size_list(flat.type) else flat
    return values.to_numpy(zero_copy_only=False).reshape(len(flat), -1)


def _statistics(rows: np.ndarray) -> dict[str, list]:
    """Of each component of `rows` (T, n)."""
    rows = rows.astype(float)
    found = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    found |= dict(zip(_quantile_names(), np.quantile(rows, QUANTILES, axis=0), strict=True))
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


def _of_pictures(counts: np.ndarray, frames: int) -> dict[str, list]:
    """Of each channel of `frames` pictures, (3, 1, 1), values divided by 255; `counts` (3, 256) of the values."""
    values, total = np.arange(256) / 255.0, counts.sum(axis=1)
    mean = counts @ values / total
    found = {"mean": mean, "std": np.sqrt(np.maximum(counts @ values**2 / total - mean**2, 0.0))}
    found |= {"min": np.array([values[row > 0].min() for row in counts])}
    found |= {"max": np.array([values[row > 0].max() for row in counts])}
    below = np.cumsum(counts, axis=1)
    for name, share in zip(_quantile_names(), QUANTILES, strict=True):
        found[name] = np.array([values[np.searchsorted(row, share * row[-1])] for row in below])
    return {name: value.reshape(3, 1, 1).tolist() for name, value in found.items()} | {"count": [frames]}


def _quantile_names() -> list[str]:
    return [f"q{round(100 * share):02d}" for share in QUANTILES]
