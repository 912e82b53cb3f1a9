"""What a worker of the bench does: one episode in, one row out, whatever happens in it."""

import dataclasses
import io
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from diagrams.episodes.calibration import Calibration, Controller, make_detector, never_fires, policy_name
from diagrams.episodes.episode import Outcome
from diagrams.episodes.fingerprint import code_hash
from diagrams.episodes.pool import kept_in_thread
from diagrams.episodes.record import PICTURE_EVERY
from diagrams.episodes.runner import Job, prepared
from diagrams.monitors.scoring import Score
from diagrams.monitors.tapes import TapedRun, replay, taped_and_recorded
from diagrams.monitors.traces import PICTURES, SHOWN, TRACE, pictures_file, trace_script
from diagrams.world.configuration import World
from diagrams.world.faults.registry import is_fault, kind_label
from diagrams.world.names import ENCODER
from models.data.runs import Tape
from models.errors import InputError
from models.inference import Policy
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES, SHIPPED

# fit: its tape is kept; calibration, off: the detectors are scored on it; loop: one of them acts.
Stage = Literal["fit", "calibration", "off", "loop"]
TAPES = "tapes"  # entry of a row that is no part of it: the content of a file in this folder of --out


@dataclass(frozen=True)
class Scored:
    """A detector that is scored, or acts; `calibration`: its gamma is not read before it is known."""

    spec: str  # see systems/detectors.py
    calibration: Calibration
    hash: str  # of what it learned and its calibration

    @property
    def label(self) -> str:
        """Its short name."""
        return DETECTORS.label(self.spec)


@dataclass(frozen=True)
class BenchTask:
    """One episode of the bench."""

    stage: Stage
    world: World
    rnn: str  # short name
    training_seed: int
    kind: str  # of disturbance or fault
    severity: float | None  # of a fault
    seed: int
    weights_hash: str  # of the policy's file
    detectors: tuple[Scored, ...] = ()  # of the loop: the one that acts
    recovery: str = SHIPPED
    code: str = dataclasses.field(default_factory=code_hash)  # that the bench was started with

    @property
    def key(self) -> str:
        """Says which episode it is; a file name without suffix."""
        severity = "" if self.severity is None else f"-{self.severity!r}"
        acts = f"-{self.detectors[0].label}-{RECOVERIES.label(self.recovery)}" if self.stage == "loop" else ""
        return f"{self.stage}-{self.rnn}-{self.training_seed}-{kind_label(self.kind)}{severity}-{self.seed}{acts}"

    @property
    def episode(self) -> tuple[str, int, str, float | None, int]:
        """Tasks alike in it are the same episode, with one detector or another, or off."""
        return self.rnn, self.training_seed, self.kind, self.severity, self.seed

    @property
    def diagram(self) -> tuple[str, ...]:
        """Tasks alike in it share one diagram: run one after another, they build it once (it is never freed)."""
        fault = self.kind if is_fault(self.kind) else ""
        acts = (self.detectors[0].spec, self.recovery) if self.stage == "loop" else ()
        return (self.rnn, f"{self.training_seed}", fault, *acts)

    def done_by(self, row: dict[str, Any] | None) -> bool:
        """Whether `row`, of this key, is what it gives: without an error, of these detectors.

        Raises InputError for one of other weights.
        """
        if row is None or row["error"] is not None:
            return False
        if row["weights_hash"] != self.weights_hash:
            raise InputError("--out holds episodes of other weights than there are now: choose another --out")
        return all(row["detectors"].get(scored.label, {}).get("hash") == scored.hash for scored in self.detectors)


def require_whole(stage: str, row: Any) -> None:
    """Raises ValueError, TypeError, KeyError or AttributeError for a row that no episode of that stage leaves."""
    whole = [isinstance(row["weights_hash"], str), isinstance(row["error"], str | None)]
    if row["error"] is None:
        whole += [isinstance(row["success"], bool), isinstance(row["void"], bool), _number(row["sim_seconds"])]
        ticks = np.inf if stage == "loop" else row["ticks"]
        whole.append(stage == "loop" or (_tick(ticks) and (row["onset"] is None or _tick(row["onset"], ticks))))
        for said in row["detectors"].values():
            whole.append(isinstance(said["hash"], str))
            if stage != "loop":
                (first, _), *_ = said["peaks"]
                whole += [first == 0, all(_tick(tick, ticks) and _number(value) for tick, value in said["peaks"])]
                whole += [said["alarm"] is None or _tick(said["alarm"], ticks), _tick(said["false_alarms"])]
    if not all(whole):
        raise ValueError(f"no row of the stage {stage}: {row!s:.80}")


def run_bench_task(folder: Path, task: BenchTask) -> dict[str, Any]:
    """Runs the episode with the files in `folder`; its row, with `error` and `traceback` set if it raised."""
    try:
        if task.code != code_hash():
            raise InputError(f"this worker has another version of the program ({code_hash()}, the bench {task.code})")
        job = job_of(folder, task)
        path = job.controller.policy
        if task.stage == "loop":
            outcome, more = _in_loop(task, job)
        else:
            run, record = taped_and_recorded(job)
            outcome, found = run.outcome, all_ratios(path, task, run)
            more = {"onset": run.onset, "ticks": len(run.tape.posture), "detectors": _scores(task, run, found)}
            if task.stage == "fit":
                more[TAPES] = tape_bytes(run.tape)
            if task.stage == "off":
                acting = [*run.tape.active[1:], run.tape.active[-1]]  # the tape has it as it is told, a tick later
                trace = trace_script(task.key, record, acting, found)
                more[SHOWN] = {TRACE: trace, PICTURES: pictures_file(record)}
        if outcome.weights_hash != task.weights_hash:
            raise InputError(f"{path} was changed under the bench: put it back")
        names = ("success", "void", "failure", "sim_seconds", "weights_hash")
        return {name: getattr(outcome, name) for name in names} | more | {"error": None, "traceback": None}
    except (Exception, SystemExit) as error:  # Drake calls exit for some of its errors
        return error_row(task, error)


def job_of(folder: Path, task: BenchTask) -> Job:
    """What is run for the task with the files in `folder`."""
    scored = task.detectors[0] if task.stage == "loop" else None
    spec, calibration = (scored.spec, scored.calibration) if scored else ("never", never_fires(1))
    path = folder / policy_name(task.rnn, task.training_seed)
    controller = Controller(path, spec, calibration, recovery=task.recovery)
    severity = 1.0 if task.severity is None else task.severity
    every = (
        PICTURE_EVERY if task.stage == "off" else 0
    )  # with the pictures of the loops a bench would be ten times as large
    return Job(task.world, folder / ENCODER, controller, task.seed, task.kind, severity, picture_every=every)


def _in_loop(task: BenchTask, job: Job) -> tuple[Outcome, dict[str, Any]]:
    """What came of the run in which the task's detector acts, and what the row has beside that."""
    rollout, episode, calibration = prepared(job)
    acting, label = list[bool](), task.detectors[0].label
    keep = lambda _: acting.append(bool(rollout.judged("acting")[0] > 0.5))  # noqa: E731
    outcome, record = rollout.run(episode, on_tick=keep, until=job.until, calibration=calibration)
    trace = trace_script(task.key, record, acting, {label: record.errors.max(axis=1)}, record.alpha)
    return outcome, {"detectors": {label: {"hash": task.detectors[0].hash}}, SHOWN: {TRACE: trace}}


def error_row(task: BenchTask, error: BaseException) -> dict[str, Any]:
    """The row of an episode that raised; it counts nowhere, and is run again at the next start."""
    words = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return {"error": words, "traceback": "".join(traceback.format_exception(error)), "weights_hash": task.weights_hash}


def all_ratios(path: Path, task: BenchTask, run: TapedRun) -> dict[str, np.ndarray]:
    """Of each detector of the task, on the run's tape, by its label: see `ratios`."""
    policy = kept_policy(path, task)
    return {scored.label: ratios(scored, policy, path.parent, run.tape) for scored in task.detectors}


def kept_policy(path: Path, task: BenchTask) -> Policy:
    """That of the task, in the file `path`: read once."""
    return kept_in_thread(("bench_policy", path, task.weights_hash), lambda: Policy(path))


def _scores(task: BenchTask, run: TapedRun, found: dict[str, np.ndarray]) -> dict[str, dict[str, Any]]:
    """What the row has of each detector; plain types."""
    return {
        scored.label: {"hash": scored.hash} | vars(Score.of(found[scored.label], scored.calibration.gamma, run.onset))
        for scored in task.detectors
    }


def ratios(scored: Scored, policy: Policy, folder: Path, tape: Tape) -> np.ndarray:
    """(T,) the largest error of each tick by its mean, of a detector whose file, if it has one, is in `folder`."""
    detector = kept_in_thread(
        ("bench_detector", folder, scored.spec, policy.hash, scored.hash),
        lambda: make_detector(scored.spec, policy, folder),
        most=32,
    )
    errors = replay(detector, tape, policy.scaling.scale(np.asarray(policy.initial_posture, float)))
    found = (errors / np.array(scored.calibration.mean_errors)).max(axis=1)
    if not np.isfinite(found).all():
        raise InputError(f"the detector '{scored.label}' has errors that are no finite numbers: leave it out")
    return found


def tape_bytes(tape: Tape) -> bytes:
    """The content of its file (.npz); single precision where that loses nothing."""
    file, arrays = io.BytesIO(), vars(tape)
    single = {name: array.astype(np.float32) for name, array in arrays.items()}
    exact = {n: single[n] if np.array_equal(single[n], array) else array for n, array in arrays.items()}
    np.savez_compressed(file, **exact)  # type: ignore[arg-type]
    return file.getvalue()


def _tick(value: Any, below: float = np.inf) -> bool:
    """Whether it is a whole number from 0 on."""
    return type(value) is int and 0 <= value < below


def _number(value: Any) -> bool:
    """Whether it is a finite number."""
    return type(value) in (int, float) and -np.inf < value < np.inf


def load_tape(path: Path, policy: Policy) -> Tape:
    """From what `tape_bytes` gave; raises InputError where there is none, or one that is none of a run of `policy`."""
    posture, features = policy.posture_size, policy.feature_size
    sizes: dict[str, tuple[int, ...]] = {
        "posture": (posture,), "recalled_postures": (policy.horizon + 1, posture), "active": (),
        "hidden_state": (policy.state_size,), "features": (features,), "predicted_features": (features,),
    }  # fmt: skip
    try:
        with np.load(path, allow_pickle=False) as file:
            tape = Tape(**{name: file[name].astype(float) for name in sizes})
        ticks = len(tape.posture)
        for name, size in sizes.items():
            if not ticks or (array := getattr(tape, name)).shape != (ticks, *size) or not np.isfinite(array).all():
                raise ValueError(f"{name} is not {ticks or 'some'} ticks of {size} finite numbers")
        return tape
    except Exception as error:  # numpy and zip raise a dozen types
        words = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path} is no whole tape ({words}): delete it, the same command makes it again") from error
