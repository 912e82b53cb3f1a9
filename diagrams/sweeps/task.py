"""What a worker of a sweep does: one episode in, one row out, whatever happens in it."""

from __future__ import annotations

import dataclasses
import hashlib
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Worker as DaskWorker
from distributed import WorkerPlugin, get_worker

from diagrams.episodes.calibration import Calibration, Controller, policy_name
from diagrams.episodes.pool import Job, Worker
from diagrams.episodes.record import stretches
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World

ENCODER = "cae.safetensors"
HASHES = ("weights_hash", "encoder_hash", "detector_hash")
RECORD = "record"  # entry of a row that is no column of the table: the content of a file of diagrams/episodes/record.py
LABELS = ("rnn", "training_seed", "detector", "gamma", "disturbance", "seed", *HASHES)


@dataclass(frozen=True)
class Task:
    """One episode of a sweep: its controller (files that WeightFiles brought), its disturbance, its seed."""

    rnn: str
    training_seed: int
    detector: str
    gamma: float | None  # instead of the calibrated one
    disturbance: str
    seed: int
    bundle: str  # hash of all files that the sweep sent
    weights_hash: str  # of the policy's file
    encoder_hash: str
    detector_hash: str | None  # of what a baseline learned and its calibration for this policy
    calibration: Calibration | None = None  # what gamma makes of the one in the files
    until: Until = "task"
    log: bool = False  # send the record along, see RECORD

    @property
    def key(self) -> str:
        """Says which episode it is; a file name without suffix."""
        gamma = "own" if self.gamma is None else repr(self.gamma)
        end = "" if self.until == "task" else f"-{self.until}"
        return f"{self.rnn}-{self.training_seed}-{self.detector}-{gamma}-{self.disturbance}-{self.seed}{end}"

    def labels(self) -> dict[str, Any]:
        """Columns of a row that are known before the episode is run."""
        return {name: getattr(self, name) for name in LABELS}


class WeightFiles(WorkerPlugin):
    """Brings the weight files to every worker, wherever it runs and whenever it starts."""

    def __init__(self, files: dict[str, bytes]):
        """`files`: name to content."""
        self.files = files
        digest = hashlib.sha256()
        for name, content in sorted(files.items()):
            digest.update(name.encode() + b"\0" + hashlib.sha256(content).digest())
        self.hash = digest.hexdigest()
        self.name = f"hindsight-{self.hash}"  # one that has another's name takes its place

    def setup(self, worker: DaskWorker) -> None:
        """Writes the files into the worker's scratch folder."""
        folder = weights_folder(worker, self.hash)
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)


def weights_folder(worker: DaskWorker, bundle: str) -> Path:
    """Where WeightFiles puts the files whose hash is `bundle`."""
    return Path(worker.local_directory) / f"weights-{bundle[:16]}"


# A renderer belongs to the thread that made it, and a worker of a foreign cluster may have several threads.
_thread = threading.local()


def _worker_of(folder: Path) -> Worker:
    if getattr(_thread, "folder", None) != folder:
        _thread.worker, _thread.folder = Worker(World(), folder / ENCODER), folder
    return _thread.worker


def run_task(task: Task) -> dict[str, Any]:
    """Runs the episode on a Dask worker; its row, with `error` set if it raised."""
    return run_in(weights_folder(get_worker(), task.bundle), task)


def run_in(folder: Path, task: Task) -> dict[str, Any]:
    """Runs the episode with the weight files in `folder`; its row, with `error` set if it raised."""
    try:
        controller = Controller(folder / policy_name(task.rnn, task.training_seed), task.detector, task.calibration)
        path = folder / f"{task.key}.npz" if task.log else None
        job = Job(task.seed, task.disturbance, task.rnn, task.until, path)
        outcome, record = _worker_of(folder).run(job, controller)
        log = {}
        if path is not None:
            log[RECORD] = path.read_bytes()
            path.unlink()
    except (Exception, SystemExit) as error:  # Drake calls exit for some of its errors
        return error_row(task, error)
    before, after = stretches(record)
    return {
        **dataclasses.asdict(outcome),
        **task.labels(),
        "error_peak_normal": _peak(record.errors[before]),
        "error_peak_disturbed": _peak(record.errors[after]),
        "error": None,
        **log,
    }


def error_row(task: Task, error: BaseException) -> dict[str, Any]:
    """The row of an episode that raised: a failure of the task and of the switching."""
    text = f"{type(error).__name__}: {' '.join(str(error).split())}"
    flags = dict.fromkeys(("success", "switch_success", "paper_switch_success"), False)
    failed = flags | {"failure": "error", "switch_failure": "error"}
    return {**task.labels(), **failed, "error": text}


def _peak(errors: np.ndarray) -> float | None:
    return float(errors.max()) if errors.size else None
