"""Stand-ins for the episodes of the bench; as a program: bench.py with them instead of real ones.

In a module of its own: the workers are other processes, which import it.
"""

import time
import zlib
from pathlib import Path

import numpy as np

from diagrams.episodes.record import ARRAYS, PICTURE_EVERY, Record
from diagrams.monitors.bench_task import TAPES, BenchTask, tape_bytes
from diagrams.monitors.scoring import Score
from diagrams.monitors.traces import PICTURES, SHOWN, TRACE, pictures_file, trace_script
from models.data.recording import RecordedRun
from models.data.runs import Tape

PAUSE, TICKS, ONSET = 0.05, 60, 20  # s; ticks
SIZES = {"posture": (8,), "recalled_postures": (11, 8), "hidden_state": (500,), "features": (30,)}  # of the LSTM
SIZES["predicted_features"] = SIZES["features"]


def chance(*words) -> np.random.Generator:
    """The same for the same words, in every process."""
    return np.random.default_rng(zlib.crc32(repr(words).encode()))


def bench_row(folder: Path, task: BenchTask) -> dict:
    """A row that depends on nothing but the task. A fault comes at tick ONSET and is seen after it, by all."""
    episode = task.training_seed, task.kind, task.severity, task.seed
    disturbed = task.kind != "none"
    success = not disturbed or bool(chance(episode, task.detectors if task.stage == "loop" else ()).uniform() < 0.5)
    row = {"success": success, "void": False, "failure": None, "sim_seconds": 6.0, "weights_hash": task.weights_hash}
    row |= {"error": None, "traceback": None}
    if task.stage == "loop":
        label, high = task.detectors[0].label, np.zeros(80)
        high[ONSET + 2 : ONSET + 20] = 1.0
        script = trace_script(task.key, *shown(80, disturbed), {label: 0.1 + 9.0 * high}, high)
        return row | {
            "sim_seconds": 8.0,
            "detectors": {label: {"hash": task.detectors[0].hash}},
            SHOWN: {TRACE: script},
        }
    onset, scores, ratios = ONSET if disturbed else None, {}, {}
    for scored in task.detectors:
        largest = 0.2 if task.stage == "off" else 0.3  # no false alarm
        ratio = largest * chance(episode, scored.label).uniform(0.0 if task.stage == "off" else 0.9, 1.0, TICKS)
        if disturbed and scored.label != "never":
            ratio[ONSET + 2 :] += 5.0
        ratios[scored.label] = ratio
        scores[scored.label] = {"hash": scored.hash} | vars(Score.of(ratio, scored.calibration.gamma, onset))
    if task.stage == "fit":
        rng = chance(episode)
        arrays = {name: rng.uniform(-0.5, 0.5, (TICKS, *size)).astype(np.float32) for name, size in SIZES.items()}
        row[TAPES] = tape_bytes(Tape(**{n: a.astype(float) for n, a in arrays.items()}, active=np.zeros(TICKS)))
    if task.stage == "off":
        record, acting = shown(TICKS, disturbed)
        row[SHOWN] = {TRACE: trace_script(task.key, record, acting, ratios), PICTURES: pictures_file(record)}
    return row | {"onset": onset, "ticks": TICKS, "detectors": scores}


def shown(ticks: int, disturbed: bool) -> tuple[Record, list[bool]]:
    """A record of so many ticks in which nothing is but pictures, each of one grey; when the fault acts."""
    arrays = {name: np.zeros(ticks) for name in ARRAYS} | {"time": 0.1 * np.arange(ticks)}
    at = np.arange(0, ticks, PICTURE_EVERY)
    arrays |= {
        "picture_ticks": at,
        "pictures": np.repeat(4 * at, 112 * 112 * 3).reshape(-1, 112, 112, 3).astype(np.uint8),
    }
    return Record(events=[(0.0, "<b>subtask 1</b>")], **arrays), [disturbed and k >= ONSET for k in range(ticks)]


def recorded(name: str, success: bool = True, **notes) -> RecordedRun:
    """A run of TICKS for a data set; it depends on nothing but its name and what is said of it."""
    rng = chance(name)
    swing = 0.1 * np.sin(0.2 * np.arange(TICKS)[:, None] * rng.uniform(0.5, 1.5, 8)) + 0.001 * rng.normal(
        size=(TICKS, 8)
    )
    pictures = np.repeat(rng.integers(0, 255, TICKS), 16 * 16 * 3).reshape(-1, 16, 16, 3).astype(np.uint8)
    return RecordedRun(
        name=name, split="train", vacant="left", success=success, rgb=pictures, posture=swing,
        actions=np.vstack((swing[1:], swing[-1:])), further={"scores": rng.uniform(size=(TICKS, 2))}, notes=notes,
    )  # fmt: skip


def slow_row(folder: Path, task: BenchTask) -> dict:
    """Takes a little time."""
    time.sleep(PAUSE)
    return bench_row(folder, task)


if __name__ == "__main__":
    import bench_fakes  # not of __main__, which the workers do not know

    from diagrams import bench
    from models.command_line import run

    bench.run_bench_task = bench_fakes.slow_row
    run(bench.main, bench.parse)
