"""sweep.py with real episodes that have SECONDS for the task, for the campaign of faults of a cluster."""

import sys
from functools import partialmethod
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from diagrams import sweep
from diagrams.episodes.rollout import Rollout
from diagrams.sweeps.task import Task, run_task
from models.command_line import run

SECONDS = 8.0  # so that disturbances come


def short_task(folder: Path, task: Task) -> dict:
    """A worker's part."""
    if not isinstance(Rollout.__dict__["run"], partialmethod):
        Rollout.run = partialmethod(Rollout.run, time_limit=SECONDS)  # type: ignore[assignment]
    return run_task(folder, task)


if __name__ == "__main__":
    from tests.campaigns import cluster_sweep  # not of __main__, which the workers do not know

    sweep.run_task = cluster_sweep.short_task
    run(sweep.main, sweep.parse)
