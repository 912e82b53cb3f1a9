"""What a worker of a sweep does: one episode in, one row out, whatever happens in it."""

import dataclasses
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.episodes.calibration import Calibration, Controller, policy_name
from diagrams.episodes.fingerprint import code_hash
from diagrams.episodes.record import PICTURE_EVERY, record_bytes, stretches
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World
from diagrams.world.faults.registry import FAULTS, is_fault, kind_label
from diagrams.world.names import ENCODER
from diagrams.world.requirements import robustness_of
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES, SHIPPED

HASHES = ("weights_hash", "encoder_hash", "detector_hash", "own_code")
# Columns: of each requirement of requirements.stl, see robustness_of; None where the switching is not judged.
ROBUSTNESS = "robustness_"
# Entries of a row that are no column of the table: by the folder in --out, the content of a file there, and its suffix.
FILES = {"records": ".npz", "mcap": ".mcap"}

DEATHS = ("WorkerDied", "KilledWorker", "MemoryError")  # how such a row's error begins
MACHINE = (*DEATHS, "ImportError", "ModuleNotFoundError")  # errors that may say nothing of the episode
MOST_LOST = 3  # episodes with such an error and no other
MOST_NAMED = 10


@dataclass(frozen=True)
class Task:
    """One episode of a sweep: its world, its controller (files of a folder), its disturbance, its seed."""

    world: World
    rnn: str  # short name
    training_seed: int
    detector: str  # see systems/detectors.py
    gamma: float | None  # instead of the calibrated one
    disturbance: str
    seed: int
    weights_hash: str  # of the policy's file
    encoder_hash: str
    detector_hash: str | None  # of what a detector learned and its calibration for this policy
    calibration: Calibration | None = None  # what gamma makes of the one in the files
    until: Until = "task"
    files: tuple[str, ...] = ()  # sent along, of FILES
    policy: str | None = None  # package.module:Class, whose name `rnn` is then
    severity: float | None = None  # of a fault; None: of no fault
    own_code: str | None = None  # hash of the files of what another package has of these; None: all are ours
    recovery: str = SHIPPED  # what the arm does after an alarm
    code: str = dataclasses.field(default_factory=code_hash)  # that the sweep was started with

    @property
    def key(self) -> str:
        """Says which episode it is; a file name without suffix."""
        gamma = "own" if self.gamma is None else repr(self.gamma)
        end = "" if self.until == "task" else f"-{self.until}"
        detector = DETECTORS.label(self.detector)
        if self.recovery != SHIPPED:
            detector += f"-{RECOVERIES.label(self.recovery)}"
        return f"{self.rnn}-{self.training_seed}-{detector}-{gamma}-{self.disturbed_by}-{self.seed}{end}"

    @property
    def disturbed_by(self) -> str:
        """The short name of the disturbance and, of a fault, its severity."""
        return kind_label(self.disturbance) + ("" if self.severity is None else f"-{self.severity!r}")

    def labels(self) -> dict[str, Any]:
        """Columns of a row that are known before the episode is run."""
        names = ("rnn", "training_seed", "gamma", "severity", "seed", *HASHES)
        labels = {"detector": DETECTORS.label(self.detector), "disturbance": kind_label(self.disturbance)}
        labels["recovery"] = RECOVERIES.label(self.recovery)
        return {name: getattr(self, name) for name in names} | labels


def own_code(detector: str, disturbance: str, recovery: str = SHIPPED) -> str | None:
    """See Task.own_code."""
    fault = FAULTS.code(disturbance) if is_fault(disturbance) else ""
    return DETECTORS.code(detector) + fault + RECOVERIES.code(recovery) or None


def run_task(folder: Path, task: Task) -> dict[str, Any]:
    """Runs the episode with the weight files in `folder`; its row, with `error` and `traceback` set if it raised."""
    try:
        if task.code != code_hash():
            raise InputError(
                f"this worker has another version of the program ({code_hash()}, the sweep {task.code}): "
                "update it, then --retry-errors"
            )
        if task.own_code != own_code(task.detector, task.disturbance, task.recovery):
            raise InputError(
                "this worker has another version of your detector, fault or recovery than the sweep was started with: "
                "start again with another --out"
            )
        path = folder / policy_name(task.rnn, task.training_seed)
        controller = Controller(path, task.detector, task.calibration, task.policy, task.recovery)
        until, every = task.until, 1 if "mcap" in task.files else PICTURE_EVERY if task.files else 0
        job = Job(
            task.world, folder / ENCODER, controller, task.seed, task.disturbance,
            1.0 if task.severity is None else task.severity, until=until, picture_every=every,
        )  # fmt: skip
        outcome, record = run_episode(job)
        if outcome.weights_hash != task.weights_hash:
            raise InputError(
                f"{task.policy or controller.policy} was changed under the sweep: put it back, then --retry-errors"
            )
        (before, after), kept = stretches(record), robustness_of(record.signals, task.world.timing.period)
        row = {
            **outcome.to_dict(),
            **task.labels(),
            "error_peak_normal": _peak(record.errors[before]),
            "error_peak_disturbed": _peak(record.errors[after]),
            **{ROBUSTNESS + name: value if outcome.judged else None for name, value in kept.items()},
            "error": None,
            "traceback": None,
        }
        if "records" in task.files:
            row["records"] = record_bytes(record, outcome)
        if "mcap" in task.files:
            from diagrams.episodes.mcap_file import mcap_bytes

            row["mcap"] = mcap_bytes(record, outcome, task.world)
    except (Exception, SystemExit) as error:  # Drake calls exit for some of its errors
        return error_row(task, error)
    return row


def error_row(task: Task, error: BaseException) -> dict[str, Any]:
    """The row of an episode that raised: a failure of the task and of the switching."""
    flags = dict.fromkeys(("success", "switch_success", "paper_switch_success"), False)
    return {
        **task.labels(),
        **flags,
        "void": False,
        "failure": "error",
        "switch_failure": "error",
        "error": f"{type(error).__name__}: {' '.join(str(error).split())}",
        "traceback": "".join(traceback.format_exception(error)),
    }


def died(row: dict[str, Any]) -> bool:
    """Whether the row is that of an episode whose worker died, or had no memory left: no result."""
    return (row["error"] or "").startswith(DEATHS)


def believed(rows: Iterable[tuple[Task, dict[str, Any]]]) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Passes rows on, but none that `died`; others of MACHINE when an episode was finished: so it was not the machine.

    Raises InputError at the end where one died, and, after MOST_LOST or at the end, where none was finished.
    """
    held, dead, finished = list[tuple[Task, dict[str, Any]]](), list[tuple[Task, dict[str, Any]]](), False
    for task, row in rows:
        finished = finished or not (row["error"] or "").startswith(MACHINE)
        (dead if died(row) else held).append((task, row))
        if finished:
            yield from held
            held.clear()
        elif len(held) + len(dead) == MOST_LOST:
            break
    for lost, what, remedy in (
        (dead, "lost their worker, or had no memory left,", "give each worker 1 GB of memory or more, or use fewer"),
        (held, "and none finished", "bring its packages to the versions of pyproject.toml"),
    ):
        if lost:
            keys = ", ".join(task.key for task, _ in lost[:MOST_NAMED]) + (" ..." if len(lost) > MOST_NAMED else "")
            words = f"{len(lost)} episodes {what} ({lost[0][1]['error']}): {keys}"
            raise InputError(f"{words}: {remedy}; then the same command goes on")


def _peak(errors: np.ndarray) -> float | None:
    return float(errors.max()) if errors.size else None
