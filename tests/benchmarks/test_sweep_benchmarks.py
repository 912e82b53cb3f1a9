"""What a sweep costs beside its episodes, and what a second worker gains: ratios, on real episodes of 4 s.

Both need the cores for themselves: pytest tests/benchmarks/test_sweep_benchmarks.py --benchmark-enable
"""

import contextlib
import time

import pytest

from diagrams.episodes import rollout
from diagrams.episodes.pool import Controller, Job, Worker
from diagrams.sweep import SweepArguments, connect, execute, plan
from diagrams.sweeps.store import EpisodeStore
from diagrams.sweeps.task import ENCODER
from diagrams.world.configuration import World
from tests.diagrams import sweep_fakes

EPISODES = 8  # a round
ROUNDS = 3


@pytest.fixture(scope="module")
def planned(weights):
    return plan(SweepArguments(episodes=EPISODES, disturbance=["A"], weights=weights))


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
def sweeping(planned, folder, workers):
    """A function that runs all episodes, on disk and all, on workers that are there already."""
    tasks, files = planned
    store = EpisodeStore(folder)

    def sweep():
        for task, row in execute(client, sweep_fakes.short_task, tasks):
            assert row["error"] is None
            store.add(task.key, row)

    with connect(None, workers) as client:
        client.register_plugin(files)
        client.wait_for_workers(workers)
        yield sweep


def test_overhead_is_at_most_5_percent(measured, planned, weights, tmp_path, monkeypatch):
    monkeypatch.setattr(rollout, "TIME_LIMIT", 4.0)
    worker, controller = Worker(World(), weights / ENCODER), Controller(weights / "lstm.safetensors")

    def bare():
        for task in planned[0]:
            worker.run(Job(task.seed, task.disturbance), controller)

    with sweeping(planned, tmp_path, 1) as sweep:
        alone, swept = measured(bare, sweep)
    assert swept <= 1.05 * alone, f"{EPISODES} episodes: {alone:.2f} s bare, {swept:.2f} s swept"


def test_two_workers_give_1_8_times_the_episodes_of_one(measured, planned, tmp_path):
    with sweeping(planned, tmp_path / "1", 1) as one_worker, sweeping(planned, tmp_path / "2", 2) as two_workers:
        one, two = measured(one_worker, two_workers)
    assert one >= 1.8 * two, f"{EPISODES} episodes: {one:.2f} s with one worker, {two:.2f} s with two"
