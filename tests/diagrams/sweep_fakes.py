"""Stand-ins for the episodes of a sweep; as a program: sweep.py with them instead of real ones.

In a module of its own: the workers are other processes, which import it.
"""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from diagrams.sweeps.task import Task

PAUSE = 0.05  # s


def outcome_row(task: Task) -> dict:
    """A row that depends on nothing but the task (but for its times)."""
    rng = np.random.default_rng([task.seed, task.training_seed, len(task.rnn)])
    disturbed = task.disturbance != "none"
    success, switched = bool(rng.uniform() < 0.8), bool(rng.uniform() < 0.9)
    started = time.perf_counter()
    return {
        **task.labels(), "can_xy": tuple(rng.uniform(size=2)), "vacant": "left", "picked": True, "placed": success,
        "home": True, "success": success, "switched": disturbed, "detection_delay_s": 0.2 if disturbed else None,
        "false_switches": 0, "returned": True if disturbed else None, "resumed": switched if disturbed else None,
        "switch_success": switched, "paper_switch_success": switched, "alpha_max_before": float(rng.uniform(0, 0.1)),
        "return_s": 2.0 if disturbed else None, "resume_s": None,
        "failure": None if success else "stalled", "switch_failure": None if switched else "not resumed",
        "sim_seconds": 40.0 + rng.uniform(), "wall_seconds": started, "realtime_factor": time.time(),
        "error_peak_normal": float(rng.uniform(1, 20)), "error_peak_disturbed": 300.0 if disturbed else None, "error": None,
    }  # fmt: skip


def slow_task(task: Task) -> dict:
    """Takes a little time."""
    time.sleep(PAUSE)
    return outcome_row(task)


def raising_task(task: Task) -> dict:
    """Raises in every fourth episode, outside of what run_task catches."""
    if task.seed % 4 == 0:
        raise RuntimeError("the arm\nfell off")
    return outcome_row(task)


def dying_task(task: Task) -> dict:
    """Kills its worker, once for each fifth episode; the policy's hash is abused to say where to note that."""
    note = Path(task.weights_hash) / task.key
    if task.seed % 5 == 0 and not note.exists():
        note.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return outcome_row(task)


def deadly_task(task: Task) -> dict:
    """Kills every worker that tries it."""
    if task.seed == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return outcome_row(task)


def short_task(task: Task) -> dict:
    """A real episode with 4 s to do the task in, and how long it took (`wall_seconds`), drawing included."""
    from diagrams.episodes import rollout
    from diagrams.sweeps import task as sweep_task

    rollout.TIME_LIMIT = 4.0
    started = time.perf_counter()
    row = sweep_task.run_task(task)
    return row | {"wall_seconds": time.perf_counter() - started}


if __name__ == "__main__":
    import sweep_fakes  # not of __main__, which the workers do not know
    import tyro

    from diagrams import sweep

    sweep.run_task = sweep_fakes.slow_task
    sys.exit(sweep.main(tyro.cli(sweep.SweepArguments)))
