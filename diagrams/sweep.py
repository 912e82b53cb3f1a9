"""Runs many episodes in parallel: every combination of networks, detectors and disturbances that is asked for.

    python diagrams/sweep.py --episodes 40 --rnn lstm gru --disturbance none A B --out outputs/sweep

Started again with the same --out it runs what is missing.
Exit code 0: done; 1: some episode raised an error; 2: bad input, or workers that died.
"""

import dataclasses
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import tyro

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.sweeps.plan import SweepArguments, plan
from diagrams.sweeps.sequential import decided, rounds
from diagrams.sweeps.task import FILES, HASHES, Task, believed, died, error_row, run_task
from diagrams.world.scenario import load_world
from models.checks import require_one_of, require_plain
from models.command_line import require, run
from models.errors import InputError
from models.files.container import write_bytes, write_text

ROWS, SUMMARY = "rows.jsonl", "summary.json"  # in the folder --out


def parse(arguments: list[str] | None = None) -> SweepArguments:
    """The command line."""
    parsed = tyro.cli(SweepArguments, args=arguments, description=__doc__)
    require_one_of(arguments, "--rnn", "--policy")
    return parsed


def workers(arguments: SweepArguments, names: list[str], most: int) -> tuple[Any, Callable[[Task], dict]]:
    """A pool of at most `most` workers, of this machine or of a cluster, and what it runs on a task."""
    if arguments.scheduler is None:
        return Pool(min(arguments.workers, most)), partial(run_task, arguments.weights)
    files = {name: (arguments.weights / name).read_bytes() for name in names}
    cluster = arguments.cluster(files)
    return cluster, cluster.with_files(run_task)


def main(arguments: SweepArguments) -> int:
    """Runs what is missing, writes episodes.parquet and summary.json, prints the table; returns the exit code."""
    from tqdm import tqdm

    arguments.check()
    optional = {"distributed": arguments.scheduler, "foxglove": arguments.mcap}
    require("pandas", "pyarrow", "scipy", *(name for name, needed in optional.items() if needed))
    from diagrams.sweeps.table import TABLE, require_rows

    arguments.require_cluster()
    world, out = load_world(arguments.world), arguments.out
    tasks, names = plan(arguments, world)
    if (out / TABLE).exists() and not (out / ROWS).exists():
        raise InputError(f"{out} holds a table without its rows ({ROWS}), which would be lost: choose another --out")
    for name in (TABLE, SUMMARY):
        require_plain(out / name, "choose another --out")
    with RowStore(out / ROWS, fingerprint(world)) as store:
        rows = store.rows
        for task in tasks:
            if isinstance(rows.get(task.key), dict) and any(
                rows[task.key].get(name) != getattr(task, name) for name in HASHES
            ):
                raise InputError(
                    f"{out} holds episodes of other weights than {arguments.weights} has now, or of another version of "
                    "your detector, fault or recovery: choose another --out"
                )
        require_rows(out / ROWS, rows)
        if more := rows.keys() - {task.key for task in tasks}:
            raise InputError(
                f"{out} holds {len(more)} episodes that are not asked for, such as {min(more)}, and its table and "
                "summary would lose them: ask for them too, or choose another --out"
            )
        for key in [key for key, row in rows.items() if died(row)]:
            del rows[key]  # of an older program
        again = {task.key for task in tasks if task.key in rows and _again(arguments, task, rows[task.key])}
        missing = [task for task in tasks if task.key not in rows or task.key in again]
        if missing:
            done = len(tasks) - len(missing)
            print(f"{len(tasks)} episodes, {done} of them done; starting the workers ...", flush=True)
            pool, function = workers(arguments, names, len(missing))
            left = {task.key for task in missing}
            parts = rounds(tasks, rows, left) if arguments.stop_when_decided else [missing]
            runs = (found for part in parts for found in pool.run(function, part, given_up=error_row))
            with pool, tqdm(total=len(tasks), initial=done, unit="episode", smoothing=0.1, disable=None) as bar:
                for task, row in believed(runs):
                    for folder in FILES.keys() & row.keys():
                        write_bytes(out / folder / f"{task.key}{FILES[folder]}", row.pop(folder))
                    store.add(task.key, row)
                    bar.update()
                    if row["error"]:
                        tqdm.write(f"{task.key}: {row['error']}")
    if arguments.stop_when_decided:
        over = decided(tasks, rows)
        for kind, e in over.items():
            print(f"{kind}: decided, e = {e:.3g}")
        tasks = [task for task in tasks if task.key in rows or task.disturbed_by not in over]
    lost = [task for task in tasks if task.key not in rows]
    if lost:
        print(f"{len(lost)} episodes were given up by the cluster: start again with the same --out", file=sys.stderr)
        return 1
    return finish(arguments, [rows[task.key] for task in tasks])


def _again(arguments: SweepArguments, task: Task, row: dict[str, Any]) -> bool:
    """Whether an episode that was run is run again: it raised an error, or a file is asked for that it has not."""
    if row["error"]:
        return arguments.retry_errors
    return any(not (arguments.out / folder / f"{task.key}{FILES[folder]}").is_file() for folder in task.files)


def finish(arguments: SweepArguments, rows: list[dict[str, Any]]) -> int:
    """Writes and prints what the rows say; returns the exit code."""
    import pandas as pd

    from diagrams.sweeps.summary import cells, comparisons, table
    from diagrams.sweeps.table import write_table

    path = write_table(arguments.out, rows)
    frame = pd.read_parquet(path)
    summary = {
        "arguments": {name: str(v) if isinstance(v, Path) else v for name, v in dataclasses.asdict(arguments).items()},
        "cells": cells(frame),
        "comparisons": comparisons(frame),
    }
    write_text(arguments.out / SUMMARY, json.dumps(summary, indent=1) + "\n")
    print(table(summary))
    errors = sum(row["error"] is not None for row in rows)
    if errors:
        words = f"{errors} of {len(rows)} episodes raised an error: see the column `traceback` of {path}"
        print(words, file=sys.stderr)
    print(f"written: {path}, {arguments.out / SUMMARY}")
    return 1 if errors else 0


if __name__ == "__main__":
    run(main, parse)
