"""`bench.py export`: the runs of a bench as data sets that others read, made again from their seeds."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Context

from diagrams.episodes.compatibility import of_data_sets
from diagrams.episodes.cores import cores
from diagrams.episodes.pool import MOST_WORKERS, Pool, kept_in_thread
from diagrams.episodes.record import Record
from diagrams.episodes.runner import Job, prepared
from diagrams.episodes.switching import GUARD
from diagrams.monitors.bench_fit import NETWORKS
from diagrams.monitors.bench_plan import NEVER
from diagrams.monitors.bench_task import BenchTask, all_ratios, job_of
from diagrams.monitors.replays import tasks_of
from diagrams.monitors.tapes import TapedRun, taped_and_recorded
from diagrams.monitors.traces import kept_trace, require_same_run
from diagrams.world.faults.registry import kind_label, require_kind
from models.checks import require_numbers, require_plain
from models.command_line import require
from models.data.recording import RecordedRun, RecordingFile, digest_of
from models.errors import InputError
from models.files.container import write_text
from systems.recoveries.registry import RECOVERIES

DIGESTS, LEROBOT, ROBOMIMIC = "digests.json", "lerobot", "robomimic.hdf5"  # in --out
MOST = 100_000  # runs

Episode = tuple[str, float | None, str, int, int]  # fault, severity, rnn, training seed, seed


@dataclass(frozen=True)
class ExportJob:
    """One run to be exported: what makes it, its name in the data set, and what is known of it."""

    task: BenchTask
    name: str
    outcomes: Mapping[str, bool]  # whether the task of the same scene is done: `never`, and DETECTOR-RECOVERY


@dataclass
class Export:
    """Writes the runs of a finished bench, made again from their seeds, to --out: lerobot/ (LeRobotDataset v3),
    robomimic.hdf5 and digests.json, SHA-256 of each run. A killed one goes on; a run that is not the bench's, to the
    bit, is refused. Exit code 1: --check found other digests; 2: bad input."""

    out: Path  # folder of the data sets
    bench: Path = Path("outputs/bench")  # --out of the bench
    stage: Literal["off", "loop"] = "off"  # with the detector off, all scored; or in closed loop, whatever alarmed
    faults: list[str] = field(default_factory=list)  # none, A, B, ...: those alone; no one named: all of the bench
    limit: int | None = None  # only so many runs
    check: float = 0.0  # share of the runs in --out that is made again, to compare the digests; nothing is written
    workers: int = field(default_factory=cores)  # processes; 0: this one

    def run(self) -> int:
        """Exports, or checks; returns the exit code."""
        require("av", "h5py", "pandas", "pyarrow", extra="files")
        require_numbers(self, {"limit": (1, MOST), "check": (0.0, 1.0), "workers": (0, MOST_WORKERS)})
        for kind in self.faults:
            require_kind(kind)
        tasks = tasks_of(self.bench, f"--bench {self.bench}")
        jobs = self._jobs(tasks)
        return self._compare(jobs) if self.check else self._write(jobs)

    def _jobs(self, tasks: list[BenchTask]) -> list[ExportJob]:
        """The runs that are asked for; raises InputError where the bench has none of them."""
        known, acted = _table(self.bench)
        labels = {kind_label(kind) for kind in self.faults}
        chosen = [
            (task, known[_episode(task)])
            for task in tasks
            if task.stage == self.stage
            and _episode(task) in known
            and (not labels or kind_label(task.kind) in labels)
            and (self.stage == "off" or (*_episode(task), task.detectors[0].label) in acted)
        ][: self.limit]
        if not chosen:
            raise InputError(f"the bench in {self.bench} has no such run: ask for other --faults, or another --stage")
        return [ExportJob(task, f"demo_{i}", outcomes) for i, (task, outcomes) in enumerate(chosen)]

    def _write(self, jobs: list[ExportJob]) -> int:
        from tqdm import tqdm

        from models.data.lerobot import LeRobotFolder

        keys = [job.task.key for job in jobs]
        settings = {"stage": self.stage, "episodes": keys, "weights": sorted({job.task.weights_hash for job in jobs})}
        names = {"scores": _scored(jobs[0].task)}
        attributes = of_data_sets(jobs[0].task.world) | {"names": json.dumps(names)}
        path = self.out / DIGESTS
        for place in (path, self.out / ROBOMIMIC):  # before a part of them is begun
            require_plain(place, "choose another --out")
        digests = _digests(path) if path.exists() else {}
        with (
            LeRobotFolder(self.out / LEROBOT, settings, attributes) as folder,
            RecordingFile(self.out / ROBOMIMIC, settings, attributes) as file,
            Pool(self.workers) as pool,
        ):
            missing = [job for job in jobs if not (job.name in folder and job.name in file and job.task.key in digests)]
            ran = pool.run(partial(record_run, self.bench), missing)
            done = len(jobs) - len(missing)
            for job, run in tqdm(ran, total=len(jobs), initial=done, unit="run", desc="export", disable=None):
                for layout in (folder, file):
                    if run.name not in layout:
                        layout.add(run)
                digests[job.task.key] = digest_of(run)
                write_text(path, json.dumps({key: digests[key] for key in keys if key in digests}, indent=1) + "\n")
            for layout in (folder, file):
                layout.finish([job.name for job in jobs])
        print(f"{len(jobs)} runs written: {self.out / LEROBOT}, {self.out / ROBOMIMIC}, {path}")
        return 0

    def _compare(self, jobs: list[ExportJob]) -> int:
        from tqdm import tqdm

        digests = _digests(self.out / DIGESTS)
        there = [job for job in jobs if job.task.key in digests]
        if not there:
            raise InputError(f"{self.out / DIGESTS} has none of these runs: check with the options of the export")
        places = np.linspace(0, len(there) - 1, max(round(self.check * len(there)), 1)).round().astype(int)
        others = []
        with Pool(self.workers) as pool:
            ran = pool.run(partial(record_run, self.bench), [there[i] for i in places])
            for job, run in tqdm(ran, total=len(places), unit="run", desc="check", disable=None):
                others += [job.task.key] if digest_of(run) != digests[job.task.key] else []
        print(f"{len(places) - len(others)} of {len(places)} runs made again have the same digest", *others, sep="\n")
        return 1 if others else 0


def record_run(bench: Path, job: ExportJob) -> RecordedRun:
    """Runs it, in a worker; raises InputError where the run is not the bench's, to the bit."""
    from models.inference import Encoder

    task, to_run = job.task, job_of(bench / NETWORKS, job.task)
    pictures, (run, record) = _seen(to_run)
    require_same_run(kept_trace(bench, task.key), record, bench, task.key)
    policy = to_run.controller.load()
    tape, outcome, ticks = run.tape, run.outcome, len(record.time)
    scores = {"": record.errors.max(axis=1)}
    if task.stage == "off":
        scores = all_ratios(to_run.controller.policy, task, run)
    encoder = kept_in_thread(("encoder", to_run.encoder), lambda: Encoder(to_run.encoder))
    return RecordedRun(
        name=job.name, split="train", vacant=outcome.vacant, success=bool(outcome.success), rgb=pictures,
        posture=record.posture, actions=record.desired_posture,
        further={
            "hidden_state": tape.hidden_state,
            "recalled_postures": policy.scaling.unscale(tape.recalled_postures).reshape(ticks, -1),
            "features": encoder.encode_batch(pictures),
            "predicted_features": tape.predicted_features,
            "scores": np.stack(list(scores.values()), axis=1),
            "alpha": record.alpha[:, None],
            "mode": (record.alpha[:, None] >= GUARD).astype(float),
            "fault_active": np.append(tape.active[1:], tape.active[-1])[:, None],
        },
        notes={
            "key": task.key, "stage": task.stage, "fault": kind_label(task.kind),
            "severity": float(task.kind != "none") if task.severity is None else task.severity,
            "onset": -1 if run.onset is None else run.onset,
            "detector": task.detectors[0].label if task.stage == "loop" else NEVER,
            "recovery": RECOVERIES.label(task.recovery) if task.stage == "loop" else "",
            "rnn": task.rnn, "training_seed": task.training_seed, "seed": task.seed,
            "can_xy": list(outcome.can_xy), "failure": outcome.failure or "", "never_success": job.outcomes[NEVER],
            "outcomes": json.dumps(dict(job.outcomes), sort_keys=True),
        },
    )  # fmt: skip


def _seen(job: Job) -> tuple[np.ndarray, tuple[TapedRun, Record]]:
    """What the network is shown in each tick, (T, height, width, 3) uint8, and the run."""
    rollout, period, pictures = prepared(job)[0], job.world.timing.period, list[np.ndarray]()

    def look(root: Context) -> None:
        """Before the updates of a tick: the pictures of a record are of its middle."""
        if abs(root.get_time() - len(pictures) * period) < 1e-6:
            context = rollout.controller.GetMyContextFromRoot(root)
            pictures.append(rollout.controller.GetInputPort("rgb_image").Eval(context).data[:, :, :3].copy())

    rollout.simulator.set_monitor(look)
    try:
        run, record = taped_and_recorded(job)
    finally:
        rollout.simulator.clear_monitor()
    return np.array(pictures[: len(record.time)]), (run, record)  # a tick in which the physics diverged is none


def _scored(task: BenchTask) -> list[str]:
    """Of what the components of `scores` are, in order: in the loop of the detector that acts."""
    return [scored.label for scored in task.detectors] if task.stage == "off" else ["acting"]


def _episode(task: BenchTask) -> Episode:
    return kind_label(task.kind), task.severity, task.rnn, task.training_seed, task.seed


def _table(bench: Path) -> tuple[dict[Episode, dict[str, bool]], set[tuple]]:
    """What came of each episode that counts, by detector and recovery, and who acted in it; of bench.parquet."""
    import pandas as pd

    from diagrams.monitors.bench_table import TABLE

    path, known, acted = bench / TABLE, dict[Episode, dict[str, bool]](), set[tuple]()
    require_plain(path, "give another --bench")
    try:
        rows: list[dict[str, Any]] = pd.read_parquet(path).to_dict("records")  # type: ignore[assignment]
        for row in rows:
            severity = None if row["severity"] is None or np.isnan(row["severity"]) else float(row["severity"])
            episode = row["fault"], severity, row["rnn"], int(row["training_seed"]), int(row["seed"])
            found = known.setdefault(episode, {NEVER: not row["needed"]})
            if row["success"] is None:  # it was scored alone
                continue
            if row["detector"] != NEVER:
                found[f"{row['detector']}-{row['recovery']}"] = bool(row["success"])
            if not np.isnan(float("nan" if row["alarm_s"] is None else row["alarm_s"])) or row["false_alarms"]:
                acted.add((*episode, row["detector"]))
    except (OSError, KeyError, TypeError, ValueError) as error:  # pyarrow's errors are among these
        words = " ".join(str(error).split())[:200]
        raise InputError(f"{path} is no table of a bench ({words}): run the bench again, it makes it") from error
    return known, acted


def _digests(path: Path) -> dict[str, str]:
    require_plain(path, "choose another --out")
    try:
        found = json.loads(path.read_text())
        if not isinstance(found, dict):
            raise TypeError(f"{found!s:.40} is no table")
        return found
    except FileNotFoundError as error:
        raise InputError(f"there is no {path}, with which --check compares: export to this --out first") from error
    except (OSError, RecursionError, TypeError, ValueError) as error:
        raise InputError(f"{path} has no digests ({error}): delete it, an export makes it again") from error
