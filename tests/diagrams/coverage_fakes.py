"""Stand-ins for the runs of `bench.py coverage`; as a program: bench.py with them instead of real ones.

In a module of its own: the workers are other processes, which import it.
"""

import io
import time
from pathlib import Path

import numpy as np

from diagrams.monitors.bench_task import BenchTask
from diagrams.monitors.coverage_runs import SCORES
from diagrams.world.configuration import World
from tests.diagrams.bench_fakes import chance

PAUSE, TICKS, ONSET, END = 0.02, 60, 20, 40  # s; ticks
DRIFTED = 2_000_000  # seeds from which on the runs of `drifted` have larger errors: the fresh ones


def watched_row(folder: Path, task: BenchTask, factor: float = 1.0) -> dict:
    """A row that depends on nothing but the task; a disturbance is seen by `recall` alone, 5 ticks after its onset.

    The arm leaves home at once, with open fingers, and again at tick 30, with closed ones.
    """
    ratios = {
        scored.label: factor * chance(task.kind, task.seed, scored.label).gamma(4.0, size=TICKS)
        for scored in task.detectors
    }
    if disturbed := task.kind != "none":
        ratios["recall"][ONSET + 5 : END] += 100.0
    posture = np.tile(World().initial_posture, (TICKS, 1))
    posture[1:, 0] += 1.0
    posture[30, 0], posture[10:50, 7] = posture[0, 0], 0.0
    file = io.BytesIO()
    columns = np.stack([*ratios.values()], axis=1).astype(np.float32)
    np.savez(file, labels=np.array([*ratios]), ratios=columns, posture=posture.astype(np.float32))
    hashes = {scored.label: scored.hash for scored in task.detectors}
    return {
        "success": True, "void": disturbed and task.seed % 10 == 3, "failure": None, "sim_seconds": 6.0,
        "weights_hash": task.weights_hash, "ticks": TICKS,
        "onset": ONSET if disturbed else None, "end": END if disturbed else TICKS,
        "detectors": {n: {"hash": hashes[n], "score": float(ratio.max())} for n, ratio in ratios.items()},
        SCORES: file.getvalue(), "error": None, "traceback": None,
    }  # fmt: skip


def drifted(folder: Path, task: BenchTask) -> dict:
    """The errors of fresh runs are twice as large as those of the calibration: it promises nothing of them."""
    return watched_row(folder, task, 2.0 if task.seed >= DRIFTED else 1.0)


def slow_row(folder: Path, task: BenchTask) -> dict:
    """Takes a little time."""
    time.sleep(PAUSE)
    return watched_row(folder, task)


if __name__ == "__main__":
    import coverage_fakes  # not of __main__, which the workers do not know

    from diagrams import bench
    from diagrams.monitors import coverage_runs
    from models.command_line import run

    coverage_runs.run_watched = coverage_fakes.slow_row
    run(bench.main, bench.parse)
