"""What a sweep costs beside its episodes, and what a second worker gains: ratios, on real episodes of 4 s.

Both need the cores for themselves: pytest tests/benchmarks/test_sweep_benchmarks.py --benchmark-enable
"""

import contextlib
import time
from functools import partial, partialmethod

import pytest

from diagrams.episodes.pool import Pool
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.store import RowStore
from diagrams.sweeps.plan import SweepArguments, plan
from diagrams.world.configuration import World
from tests.diagrams.sweep_fakes import SECONDS, short_task

EPISODES = 8  # a round
ROUNDS = 3


@pytest.fixture(scope="module")
def tasks(weights):
    return plan(SweepArguments(episodes=EPISODES, disturbance=["A"], weights=weights), World())[0]


@pytest.fixture
def measured(benchmark):
    """Called with the functions to time in turns: the shortest time of each, s."""
    if not benchmark.enabled:
        pytest.skip("needs the cores for itself: --benchmark-enable")

    def measure(*functions):
        times = []
        for function in functions:
            function()  # builds the diagrams
        for _ in range(ROUNDS):
            times.append([])
            for function in functions:
                start = time.perf_counter()
                function()
                times[-1].append(time.perf_counter() - start)
        shortest = [min(row[i] for row in times) for i in range(len(functions))]
        benchmark.extra_info["seconds"] = shortest
        benchmark.pedantic(lambda: None)
        return shortest

    return measure


@contextlib.contextmanager
def sweeping(tasks, weights, folder, workers):
    """A function that runs all episodes, on disk and all, on workers that stay."""

    def sweep():
        for task, row in pool.run(partial(short_task, weights), tasks):
            assert row["error"] is None
            store.add(task.key, row)

    with RowStore(folder / "rows.jsonl", {}) as store, Pool(workers) as pool:
        yield sweep


def test_overhead_is_at_most_5_percent(measured, tasks, weights, tmp_path, monkeypatch):
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=SECONDS))  # in this process

    def bare():
        for task in tasks:
            assert short_task(weights, task)["error"] is None

    with sweeping(tasks, weights, tmp_path, 1) as sweep:
        alone, swept = measured(bare, sweep)
    assert swept <= 1.05 * alone, f"{EPISODES} episodes: {alone:.2f} s bare, {swept:.2f} s swept"


def test_two_workers_give_1_8_times_the_episodes_of_one(measured, tasks, weights, tmp_path):
    with (
        sweeping(tasks, weights, tmp_path / "1", 1) as one_worker,
        sweeping(tasks, weights, tmp_path / "2", 2) as two_workers,
    ):
        one, two = measured(one_worker, two_workers)
    assert one >= 1.8 * two, f"{EPISODES} episodes: {one:.2f} s with one worker, {two:.2f} s with two"
