"""Runs many episodes over many processes: every combination of networks, detectors and disturbances that is asked for.

    python diagrams/sweep.py --episodes 40 --rnn lstm gru --disturbance none A B --out outputs/sweep

Started again with the same --out it runs what is missing. Exit code 0: done; 1: some episode raised an error; 2: bad input.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro

from diagrams.episodes.calibration import learned_hash, policy_name, stored_calibration
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, episode_seeds
from diagrams.world.names import DISTURBANCES, WEIGHTS
from models.errors import InputError
from models.files.weights import WeightsError
from models.networks import NETWORKS
from systems.detectors import DETECTORS

try:
    from distributed import Client, LocalCluster, as_completed

    from diagrams.sweeps.store import EpisodeStore
    from diagrams.sweeps.task import ENCODER, HASHES, RECORD, Task, WeightFiles, error_row, run_task
except ModuleNotFoundError as absent:
    print(f"error: a sweep needs {absent.name}: pip install -e '.[sweep]'", file=sys.stderr)
    sys.exit(2)


@dataclass
class SweepArguments:
    """Every combination of the options that take several values is run, on the same episodes."""

    episodes: int = 40  # of each combination
    seed: int = 0  # episode i has the same scene and disturbance under every controller
    purpose: Literal["evaluation", "validation"] = "evaluation"  # whose scenes: remedies are chosen on validation
    rnn: list[str] = field(default_factory=lambda: ["lstm"])  # lstm, gru, mtrnn
    detector: list[str] = field(default_factory=lambda: ["recall"])  # recall, knn, subspace
    disturbance: list[str] = field(default_factory=lambda: list(DISTURBANCES))  # none, A, B
    training_seeds: list[int] = field(default_factory=lambda: [0])  # 0 is lstm.safetensors, 1 is lstm-1.safetensors
    until: Literal["task", "switching"] = "task"  # switching: ends once that is decided, the task is not judged
    gamma: list[float] = field(default_factory=list)  # of the paper's rule (there 3, times mean errors), not calibrated
    workers: int = os.cpu_count() or 1  # processes of this machine
    scheduler: str | None = None  # address of a running Dask cluster, tcp://...; its own workers are used
    weights: Path = WEIGHTS  # folder of the trained networks
    out: Path = Path("outputs/sweep")  # folder of episodes.parquet, summary.json and the parts
    log: bool = False  # keep the record of each episode that is run in OUT/records, for analysis.py modes
    retry_errors: bool = False  # run episodes that raised an error once more


def check(arguments: SweepArguments) -> None:
    """Raises InputError for a value outside its choices."""
    for name, values, choices in (
        ("rnn", arguments.rnn, NETWORKS),
        ("detector", arguments.detector, DETECTORS),
        ("disturbance", arguments.disturbance, DISTURBANCES),
    ):
        for value in values:
            if value not in choices:
                raise InputError(f"there is no {name} '{value}': choose from {', '.join(choices)}")
        if not values:
            raise InputError(f"no {name} is given: choose from {', '.join(choices)}")
    for what, number, least, most in (
        ("number of episodes", arguments.episodes, 1, SEEDS_APART),
        ("seed", arguments.seed, 0, SEED_BLOCKS - 1),
        ("number of workers", arguments.workers, 1, 1000),
        *(("training seed", seed, 0, 999) for seed in arguments.training_seeds),
    ):
        if not least <= number <= most:
            raise InputError(f"the {what} {number} is out of range: choose from {least} to {most}")
    for gamma in arguments.gamma:
        if not (math.isfinite(gamma) and gamma > 0.0):
            raise InputError(f"the gamma {gamma} is out of range: choose a finite one above 0")
    if arguments.log and arguments.until != "task":
        raise InputError("--log keeps whole episodes, which --until switching cuts short: leave one of them out")
    if not arguments.training_seeds:
        raise InputError("no training seed is given: choose from 0 on")


def plan(arguments: SweepArguments) -> tuple[list[Task], WeightFiles]:
    """The episodes in the order of the table, and the files that they need.

    Raises WeightsError or InputError if a file is missing, damaged, or does not fit the others.
    """
    from models.files.weights import file_hash, load_autoencoder
    from models.inference import Policy

    folder = arguments.weights
    names = {ENCODER} | {f"{name}.safetensors" for name in arguments.detector if name != "recall"}
    load_autoencoder(folder / ENCODER)
    encoder_hash = file_hash(folder / ENCODER)
    gammas: list[float | None] = [*_unique(arguments.gamma)] or [None]
    controllers, hashes = [], dict[str, str]()
    for rnn, training_seed in itertools.product(_unique(arguments.rnn), _unique(arguments.training_seeds)):
        name = policy_name(rnn, training_seed)
        names.add(name)
        policy = Policy(folder / name)
        if policy.name != rnn:
            raise WeightsError(folder / name, f"holds the network '{policy.name}', not '{rnn}'", "Give it its own name")
        if policy.hash in hashes:
            raise WeightsError(folder / name, f"is the same file as {hashes[policy.hash]}", "Give each seed its own")
        hashes[policy.hash] = name
        if policy.encoder_hash != encoder_hash:
            raise WeightsError(folder / name, f"was trained with another autoencoder than {ENCODER}", "Give that one")
        for detector, gamma in itertools.product(_unique(arguments.detector), gammas):
            own = stored_calibration(detector, policy, folder, gamma)
            learned = None if detector == "recall" else learned_hash(folder, detector, policy.hash)
            calibration = None if gamma is None else own
            controllers.append((rnn, training_seed, detector, gamma, policy.hash, learned, calibration))
    files = WeightFiles({name: (folder / name).read_bytes() for name in names})
    seeds = episode_seeds(arguments.purpose, arguments.seed, arguments.episodes)
    return [
        Task(
            rnn, training_seed, detector, gamma, kind, seed, files.hash, policy_hash, encoder_hash, learned, own,
            arguments.until, arguments.log,
        )
        for rnn, training_seed, detector, gamma, policy_hash, learned, own in controllers
        for kind in _unique(arguments.disturbance)
        for seed in seeds
    ], files  # fmt: skip


def _unique(values: list) -> list:
    return list(dict.fromkeys(values))


@contextmanager
def connect(scheduler: str | None, workers: int) -> Iterator[Client]:
    """A client of the cluster at `scheduler`, or of one of `workers` processes of one thread each on this machine."""
    import dask

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=20)
        except (OSError, ValueError) as error:
            raise InputError(f"there is no Dask scheduler at {scheduler} ({error}): check the address") from error
        with client:
            yield client
        return
    # Left alone, Dask looks at its processes and their stacks up to a hundred times a second, a tenth of a core; and has the workers
    # give back what they free beyond 64 KiB, so that each picture takes hundreds of fresh pages, a fifth of a tick.
    quiet = {
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "1s",
        # One task at a time: whoever waits on a worker that dies is suspected with the one that runs.
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    }
    with (
        dask.config.set(quiet),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def execute(
    client: Client, run: Callable[[Task], dict[str, Any]], tasks: list[Task]
) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Runs `run` on each task on the workers; yields each with its row as it comes.

    A worker that dies is replaced and its task run again; a task under which workers die again and again becomes a row with that error.
    A task that the cluster gave up (its scheduler is lost) does not come.
    """
    futures = client.map(run, tasks, pure=False)
    asked = dict(zip((future.key for future in futures), tasks, strict=True))
    # Only what is under way is kept: a result that was taken is let go.
    completed = as_completed(futures)
    del futures
    for future in completed:
        task = asked[future.key]
        if future.status in ("lost", "pending"):  # its worker died before the row was fetched: it is run again
            completed.add(future)
            continue
        if future.status == "finished":
            yield task, future.result()
        elif future.status == "error":
            yield task, error_row(task, future.exception())
        future.release()


def main(arguments: SweepArguments) -> int:
    """Runs what is missing, writes episodes.parquet and summary.json, prints the table; returns the exit code."""
    from tqdm import tqdm

    check(arguments)
    tasks, files = plan(arguments)
    store = EpisodeStore(arguments.out)
    rows = store.read(task.key for task in tasks)
    for task in tasks:
        if task.key in rows and any(rows[task.key][name] != getattr(task, name) for name in HASHES):
            raise InputError(
                f"{arguments.out} holds episodes of other weights than {arguments.weights} has now: choose another --out"
            )
    missing = [t for t in tasks if t.key not in rows or (arguments.retry_errors and rows[t.key]["error"] is not None)]
    if missing:
        print(f"{len(tasks)} episodes, {len(tasks) - len(missing)} of them done; starting the workers ...", flush=True)
        with (
            connect(arguments.scheduler, min(arguments.workers, len(missing))) as client,
            tqdm(
                total=len(tasks), initial=len(tasks) - len(missing), unit="episode", smoothing=0.1, disable=None
            ) as bar,
        ):
            client.register_plugin(files)
            for task, row in execute(client, run_task, missing):
                if (record := row.pop(RECORD, None)) is not None:
                    store.keep_record(task.key, record)
                store.add(task.key, row)
                rows[task.key] = row
                bar.update()
                if row["error"] is not None:
                    tqdm.write(f"{task.key}: {row['error']}")
    lost = [task for task in tasks if task.key not in rows]
    if lost:
        print(f"{len(lost)} episodes were given up by the cluster: start again with the same --out", file=sys.stderr)
        return 1
    return finish(arguments, store, [rows[task.key] for task in tasks])


def finish(arguments: SweepArguments, store: EpisodeStore, rows: list[dict[str, Any]]) -> int:
    """Writes and prints what the rows say; returns the exit code."""
    import pandas as pd

    from diagrams.sweeps.summary import cells, comparisons, table

    path = store.finish(rows)
    frame = pd.read_parquet(path)
    summary = {
        "arguments": {name: str(v) if isinstance(v, Path) else v for name, v in dataclasses.asdict(arguments).items()},
        "cells": cells(frame),
        "comparisons": comparisons(frame),
    }
    (store.folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    print(table(summary))
    errors = sum(row["error"] is not None for row in rows)
    if errors:
        print(f"{errors} of {len(rows)} episodes raised an error: see the column `error` of {path}", file=sys.stderr)
    print(f"written: {path}, {store.folder / 'summary.json'}")
    return 1 if errors else 0


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(SweepArguments, description=__doc__)))
    except (InputError, WeightsError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
