"""Stand-ins for the episodes of a sweep; as a program: sweep.py with them instead of real ones.

In a module of its own: the workers are other processes, which import it.
"""

import os
import signal
import time
from functools import partialmethod
from pathlib import Path

import numpy as np

from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import SEEDS_APART
from diagrams.sweeps.task import ROBUSTNESS, Task, error_row, run_task
from diagrams.world.configuration import World
from diagrams.world.requirements import requirements

PAUSE = 0.05  # s
SECONDS = 4.0  # that a short task has for the task


def make_task(seed=0, disturbance="none", **changes) -> Task:
    """A task of the LSTM, on weights without a hash."""
    values = {
        "world": World(), "rnn": "lstm", "training_seed": 0, "detector": "recall", "gamma": None,
        "weights_hash": "", "encoder_hash": "", "detector_hash": None,
    }  # fmt: skip
    return Task(seed=seed, disturbance=disturbance, **(values | changes))


def outcome_row(folder: Path, task: Task) -> dict:
    """A row that depends on nothing but the task (but for its times)."""
    rng = np.random.default_rng([task.seed, task.training_seed, len(task.rnn)])
    disturbed = task.disturbance != "none"
    success, switched = bool(rng.uniform() < 0.8), bool(rng.uniform() < 0.9)
    started = time.perf_counter()
    return {
        **task.labels(), "can_xy": tuple(rng.uniform(size=2)), "vacant": "left", "picked": True, "placed": success,
        "home": True, "success": success, "switched": disturbed, "detection_delay_s": 0.2 if disturbed else None,
        "void": False, "way_home_clear": task.seed % 8 > 0 if disturbed else None, "guard_crossings": 2 * disturbed,
        "later_switches": 0, "needless_s": 0.0, "way_home_m": 0.02 if disturbed else None, "way_home_nearest": None,
        "false_switches": 0, "returned": True if disturbed else None, "resumed": switched if disturbed else None,
        "switch_success": switched, "paper_switch_success": switched, "alpha_max_before": float(rng.uniform(0, 0.1)),
        "return_s": 2.0 if disturbed else None, "resume_s": None,
        "failure": None if success else "stalled", "switch_failure": None if switched else "not resumed",
        "sim_seconds": 40.0 + rng.uniform(), "wall_seconds": started, "realtime_factor": time.time(),
        "error_peak_normal": float(rng.uniform(1, 20)), "error_peak_disturbed": 300.0 if disturbed else None,
        "error": None, "traceback": None, **{ROBUSTNESS + name: 0.5 for name in requirements(0.1)},
    }  # fmt: skip


def slow_task(folder: Path, task: Task) -> dict:
    """Takes a little time."""
    time.sleep(PAUSE)
    return outcome_row(folder, task)


def failing_task(folder: Path, task: Task) -> dict:
    """Fails in every fourth episode."""
    if task.seed % 4 == 0:
        try:
            raise RuntimeError("the arm\nfell off")
        except RuntimeError as error:
            return error_row(task, error)
    return outcome_row(folder, task)


def dying_task(folder: Path, task: Task) -> dict:
    """Kills its worker, once for each fifth episode; that is noted in `folder`."""
    note = folder / task.key
    if task.seed % 5 == 0 and not note.exists():
        note.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return outcome_row(folder, task)


def deadly_task(folder: Path, task: Task) -> dict:
    """Kills every worker that tries the first episode."""
    if task.seed % SEEDS_APART == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return outcome_row(folder, task)


def task_with_files(folder: Path, task: Task) -> dict:
    """Says which files came to the worker."""
    files = ", ".join(f"{path.name} {path.read_text()}" for path in sorted(folder.iterdir()))
    return outcome_row(folder, task) | {"vacant": files}


def short_task(folder: Path, task: Task) -> dict:
    """A real episode with SECONDS to do the task in."""
    if not isinstance(Rollout.__dict__["run"], partialmethod):
        Rollout.run = partialmethod(Rollout.run, time_limit=SECONDS)
    return run_task(folder, task)


if __name__ == "__main__":
    import sweep_fakes  # not of __main__, which the workers do not know

    from diagrams import sweep
    from models.command_line import run

    sweep.run_task = sweep_fakes.slow_task
    run(sweep.main, sweep.parse)
