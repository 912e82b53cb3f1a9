"""What a sweep costs beside its episodes, and what a second worker gains: on whole episodes of the shipped weights."""

import contextlib
import time
from functools import partial

import pytest

from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.sweeps.plan import SweepArguments, plan
from diagrams.sweeps.task import run_task
from diagrams.world.names import WEIGHTS

EPISODES = 4  # a round


@pytest.fixture(scope="module")
def tasks(world, measure):
    if not measure:
        pytest.skip("whole episodes, and tests of the sweep are elsewhere: --measure")
    return plan(SweepArguments(episodes=EPISODES, disturbance=["A"], purpose="validation"), world)[0]


@contextlib.contextmanager
def sweeping(tasks, folder, workers):
    """A function that runs all episodes, on disk and all, on workers that stay; it returns its time, s."""

    def sweep():
        start = time.perf_counter()
        for task, row in pool.run(partial(run_task, WEIGHTS), tasks):
            assert row["error"] is None
            store.add(task.key, row)
        return time.perf_counter() - start

    with RowStore(folder / "rows.jsonl", {}) as store, Pool(workers) as pool:
        yield sweep


def test_a_sweep_over_a_bare_loop(tasks, in_turns, hold, tmp_path):
    def bare():
        start = time.perf_counter()
        for task in tasks:
            assert run_task(WEIGHTS, task)["error"] is None
        return time.perf_counter() - start

    with sweeping(tasks, tmp_path, 1) as sweep:
        (ratio,) = in_turns(sweep, bare)
    hold("sweep over a bare loop", ratio, at_most=1.03)


def test_one_worker_over_two(tasks, in_turns, hold, tmp_path):
    with sweeping(tasks, tmp_path / "1", 1) as one, sweeping(tasks, tmp_path / "2", 2) as two:
        (ratio,) = in_turns(one, two)
    hold("one worker over two", ratio, at_least=1.9)
