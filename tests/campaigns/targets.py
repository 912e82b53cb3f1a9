"""The programs that are killed: how each is started in its smallest size, what it has finished, what it leaves."""

import functools
import hashlib
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.campaigns import fakes

VOLATILE = "wall_seconds", "realtime_factor"  # times; all else is the same for the same weights and seeds


@dataclass(frozen=True)
class Target:
    """A program that is started again after a kill.

    `arguments`: of `given`, the folder of the inputs, and `out`. `patch`: puts what is made up into its place. `kept`:
    how much is finished on the disk in `out`. `left`: what it leaves, comparable; None: all files, byte by byte.
    """

    program: str
    arguments: Callable[[Path, Path], list[str]]
    kept: Callable[[Path], int]
    patch: Callable[[], None] = lambda: None
    left: Callable[[Path], Any] | None = None
    workers: bool = True
    rows: str | None = None  # a file whose lines come in any order
    code: int = 0  # its exit code where nothing happens to it

    def run(self, given: Path, out: Path, stay: bool = False) -> None:
        """In a process of its own: ends it. In the folder above `out`, unless it shall `stay` where it is."""
        import importlib

        from models import command_line

        self.patch()
        program = importlib.import_module(self.program)
        sys.argv = [self.program, *self.arguments(given, out)]
        if not stay:
            out.parent.mkdir(parents=True, exist_ok=True)
            os.chdir(out.parent)
        command_line.run(program.main, program.parse)

    def files(self, out: Path) -> Any:
        """What it left."""
        if self.left is not None:
            return self.left(out)
        return hashes(out, self.rows), self.rows and sorted((out / self.rows).read_text().splitlines())


def hashes(folder: Path, but: str | None = None) -> dict[str, str]:
    """SHA-256 of all files in `folder`, `but` one."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != but
    }


def rows_of(name: str) -> Callable[[Path], int]:
    """Counts the rows of a store."""

    def count(out: Path) -> int:
        path = out / name
        return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0

    return count


# Trainings.


def _note_updates() -> None:
    from models.training import cae, rnn

    for kind in (cae.CaeTraining, rnn.SequenceTraining):
        make_batch = kind.make_batch

        def noted(self, step, make_batch=make_batch):
            fakes.note(f"update {step}")
            return make_batch(self, step)

        kind.make_batch = noted


def _updates(out: Path) -> int:
    """Of the checkpoint in `out`."""
    import torch

    paths = [path for path in out.glob("*.ckpt") if ".part" not in path.name]
    return torch.load(paths[0], weights_only=True)["done"] if paths else 0


def training(*command: str) -> Target:
    """`python -m models.training COMMAND` for eight updates, a checkpoint every third."""
    return Target(
        "models.training.__main__",
        lambda given, out: [
            *(word.format(given=given) for word in command),
            "--data",
            f"{given}/tiny.h5",
            "--out",
            str(out),
            "--checkpoint-every",
            "3",
            "--batch-size",
            "4",
        ],
        _updates,
        _note_updates,
        workers=False,
    )


# Episodes.


def swap(module: str, **made_up: Any) -> None:
    import importlib

    for name, value in made_up.items():
        setattr(importlib.import_module(module), name, value)


def _without_times(out: Path) -> Any:
    """Rows and summary of a sweep."""
    import pyarrow.parquet as pq

    summary = json.loads((out / "summary.json").read_text())
    summary["arguments"].pop("out")
    found = [*pq.read_table(out / "episodes.parquet").to_pylist(), *summary["cells"]]
    return [{name: value for name, value in row.items() if name not in VOLATILE} for row in found], summary["arguments"]


def _demonstrations(path: Path) -> Any:
    """Content of the HDF5 file: the order in which demonstrations came is not part of it."""
    import h5py

    from models.data.recording import content_hash

    with h5py.File(path) as file:
        assert file["data"].attrs["content_hash"] == content_hash(file)
        return content_hash(file), sorted(file["data"]), int(file["data"].attrs["total"]), sorted(file)


def _in_hdf5(out: Path) -> int:
    import h5py

    if not (out / "y.h5").exists():
        return 0
    with h5py.File(out / "y.h5") as file:
        return len(file["data"])


def weights_of(given: Path) -> list[str]:
    return ["--weights", f"{given}/weights"]


def _calibrate_left(out: Path) -> Any:
    rows = [json.loads(line) for line in (out / "kept" / "lstm.jsonl").read_text().splitlines()]
    return sorted(json.dumps(row) for row in rows), hashlib.sha256((out / "lstm.onnx").read_bytes()).hexdigest()


def _begin_baselines(given: Path, out: Path) -> list[str]:
    import shutil

    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(given / "weights" / "lstm.onnx", out)
    sizes = ["--episodes", "3", "--disturbed", "2", "--trials", "1", "--factors", "1", "0.5", "--betas", "30"]
    return [
        "--policies", f"{out}/lstm.onnx", "--data", f"{given}/waving.h5", "--encoder", f"{given}/weights/encoder.onnx",
        "--workers", "2", *sizes,
    ]  # fmt: skip


def _calibrated(out: Path) -> int:
    from models.files.detectors import load_detector

    found = [out / f"{name}.safetensors" for name in ("knn", "subspace")]
    return sum(len(load_detector(path, path.stem).calibrations) for path in found if path.exists()) * BASELINE_JOBS


BASELINE_JOBS = 3 + 2 + 2 + 3 * 2  # of a detector


def _patch_falsification() -> None:
    from diagrams.hybrid.perturbations import NominalRun
    from diagrams.world.configuration import World

    swap("diagrams.hybrid.falsification", run_episode=fakes.run_episode)
    home = World().initial_posture[:7]
    NominalRun.command_at = lambda self, subtask, level: home  # type: ignore[method-assign]


def _patch_return() -> None:
    swap("diagrams.hybrid.return_samples", run_draw=fakes.run_draw)
    swap("diagrams.hybrid.return_trajectories", run_job=fakes.run_way_home)
    least = {"box": 10, "draws": 4}
    swap("diagrams.hybrid.return_certificate", LEAST_CALIBRATION=least, measured_delay_margin=lambda *_: 15)


def _patch_bench() -> None:
    from diagrams.monitors.bench_fit import Fitted

    swap("diagrams.bench", run_bench_task=fakes.run_bench_task)
    fit = Fitted._fit

    def noted(self, label, *runs):
        fit(self, label, *runs)
        fakes.note(f"fit {label}")

    Fitted._fit = noted  # type: ignore[method-assign]


def _benched(out: Path) -> int:
    """Episodes and fitted detectors."""
    from models.files.tensors import read_tensors

    fitted = [read_tensors(path, "detector", "")[1] for path in (out / "networks").glob("*.safetensors")]
    return rows_of("rows.jsonl")(out) + sum(len(header["metadata"]) for header in fitted)


def _exported(out: Path) -> int:
    path = out / "digests.json"
    return len(json.loads(path.read_text())) if path.exists() else 0


def _export_left(out: Path) -> Any:
    return _demonstrations(out / "robomimic.hdf5"), hashes(out, "robomimic.hdf5")


PICTURES = ("replay.html", "plot.png", "graphviz.svg", "video.mp4", "film.webp")


def _short_episodes() -> None:
    from diagrams.episodes.rollout import Rollout

    Rollout.run = functools.partialmethod(Rollout.run, time_limit=1.0)  # type: ignore[method-assign, assignment]


def _pick_place_left(out: Path) -> Any:
    """The run to the bit, and whether each picture can be looked at."""
    import cv2
    from PIL import Image

    from diagrams.episodes.record import load_record, record_hash

    record, outcome = load_record(out / "record.npz")
    assert (out / "json.json").exists()
    for name in PICTURES:
        assert (out / name).stat().st_size > 0, name
    for name in ("plot.png", "film.webp"):
        Image.open(out / name).load()
    frames = int(cv2.VideoCapture(str(out / "video.mp4")).get(cv2.CAP_PROP_FRAME_COUNT))
    return record_hash(record), frames, outcome["failure"]


TARGETS: dict[str, Target] = {
    "pick_place": Target(
        "diagrams.pick_place",
        lambda given, out: [
            "--disturbance", "none", "--json", f"{out}/json.json", "--record", f"{out}/record.npz",
            "--mcap", f"{out}/mcap.mcap",
            *(word for name in PICTURES for word in (f"--{name.partition('.')[0]}", f"{out}/{name}")),
        ],
        lambda out: 0, _short_episodes, _pick_place_left, workers=False, code=1,
    ),
    "teach": Target(
        "diagrams.teach", lambda given, out: ["--out", f"{out}/y.h5", "--limit", "12", "--workers", "2"], _in_hdf5,
        lambda: swap("diagrams.teach", demonstrate=fakes.demonstrate), lambda out: _demonstrations(out / "y.h5"),
    ),
    "teach-lerobot": Target(
        "diagrams.teach",
        lambda given, out: ["--out", f"{out}/y", "--limit", "8", "--workers", "2", "--format", "lerobot"],
        lambda out: len([*(out / "y" / "data").rglob("file-???.parquet")]),
        lambda: swap("diagrams.teach", demonstrate=fakes.demonstrate),
    ),
    "cae": training("cae", "--max-images", "32", "--precision", "float32"),
    "rnn": training("rnn", "--rnn", "tests.models.outside:Elman", "--encoder", "{given}/encoder.onnx", "--steps", "8",
                    "--features", "{given}/features.npz", "--validate-every", "3"),
    "recall": training("recall", "--policy", "{given}/rnn-8.onnx", "--encoder", "{given}/encoder.onnx", "--steps", "8",
                       "--features", "{given}/features.npz"),
    "calibrate": Target(
        "diagrams.calibrate",
        lambda given, out: [
            "--candidates", f"{given}/weights/lstm.onnx", "--out", f"{out}/lstm.onnx", "--kept", f"{out}/kept",
            "--encoder", f"{given}/weights/encoder.onnx", "--episodes", "4", "--runs", "12", "--disturbed", "4",
        ],
        rows_of("kept/lstm.jsonl"),
        lambda: swap("diagrams.episodes.validation", run_validation=fakes.run_validation), _calibrate_left,
    ),
    "baselines": Target(
        "diagrams.baselines", _begin_baselines, _calibrated,
        lambda: swap("diagrams.episodes.validation", run_validation=fakes.run_validation),
    ),
    "sweep": Target(
        "diagrams.sweep",
        lambda given, out: [*weights_of(given), "--out", str(out), "--episodes", "8", "--disturbance", "none", "A",
                            "--workers", "2"],
        rows_of("rows.jsonl"), lambda: swap("diagrams.sweep", run_task=fakes.run_task), _without_times,
    ),
    "sweep-blocked": Target(
        "diagrams.sweep",
        lambda given, out: [*weights_of(given), "--out", str(out), "--episodes", "40", "--disturbance", "A",
                            "--workers", "2", "--way-home", "blocked"],
        lambda out: rows_of("rows.jsonl")(out) + rows_of("blocked.jsonl")(out),
        lambda: (swap("diagrams.sweep", run_task=fakes.run_task),
                 swap("diagrams.sweeps.blocked", _blocked=fakes.blocked)), _without_times,
    ),
    "falsify": Target(
        "diagrams.analysis",
        lambda given, out: ["falsify", "--out", str(out), *weights_of(given), "--trials", "4", "--scenes", "1"],
        rows_of("falsify_trials.jsonl"), _patch_falsification, rows="falsify_trials.jsonl",
    ),
    "return": Target(
        "diagrams.analysis", lambda given, out: ["return", "--out", str(out), "--samples", "10", "--draws", "3"],
        rows_of("return_trajectories.jsonl"), _patch_return,
    ),
    "resume": Target(
        "diagrams.analysis",
        lambda given, out: ["resume", "--out", str(out), *weights_of(given), "--starts", "40", "--compared", "10",
                            "--runs", "6"],
        rows_of("resume_starts.jsonl"),
        lambda: swap("diagrams.hybrid.resumption", run_scene=fakes.run_scene, run_disturbed=fakes.run_disturbed,
                      STARTS_A_SCENE=5),
    ),
    "defeat": Target(
        "diagrams.analysis",
        lambda given, out: ["defeat", "--out", str(out), *weights_of(given), "--kinds", "A", "--population", "6",
                            "--kept", "0.5", "--repetitions", "2"],
        rows_of("defeat_cases.jsonl"), lambda: swap("diagrams.hybrid.defeat_cases", run_case=fakes.run_case),
        rows="defeat_cases.jsonl",
    ),
    "bench": Target(
        "diagrams.bench",
        lambda given, out: [*weights_of(given), "--out", str(out), "--detectors", "recall", "knn", "mahalanobis",
                            "--faults", "A", "payload", "--episodes", "2", "--fit-runs", "4", "--calibration-runs", "3",
                            "--recoveries", "planned", "hold", "--workers", "2"],
        _benched, _patch_bench, rows="rows.jsonl",
    ),
    "export": Target(
        "diagrams.bench",
        lambda given, out: ["export", "--bench", f"{given}/bench", "--out", str(out), "--workers", "2"],
        _exported, lambda: swap("diagrams.monitors.export", record_run=fakes.record_run), _export_left,
    ),
    "coverage": Target(
        "diagrams.bench",
        lambda given, out: ["coverage", "--bench", f"{given}/bench", "--out", str(out), "--runs", "12",
                            "--calibration-runs", "8", "--disturbed", "4", "--deltas", "0.5", "--resamples", "2",
                            "--workers", "2"],
        rows_of("rows.jsonl"), lambda: swap("diagrams.monitors.coverage_runs", run_watched=fakes.run_watched),
        rows="rows.jsonl",
    ),
}  # fmt: skip
