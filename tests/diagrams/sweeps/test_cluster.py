"""A Dask cluster with the pool's face: files reach its workers, dead ones are replaced."""

from functools import partial

import dask
import pytest
from distributed import LocalCluster

from diagrams import sweep
from diagrams.episodes.pool import Pool
from diagrams.sweeps import cluster as cluster_module
from diagrams.sweeps.cluster import DaskPool
from diagrams.sweeps.plan import SweepArguments
from diagrams.sweeps.task import error_row
from models.errors import InputError
from tests.diagrams import sweep_fakes
from tests.diagrams.sweep_fakes import make_task
from tests.diagrams.test_sweep import without_times
from tests.diagrams.untrained import save_untrained

LOCAL = {"n_workers": 1, "threads_per_worker": 1, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}


@pytest.fixture(scope="module")
def cluster():
    """A cluster with its workers in this process: it starts at once, and sees what tests replace."""
    with LocalCluster(processes=False, **LOCAL) as cluster:
        yield cluster


def test_files_reach_the_workers(cluster):
    tasks = [make_task(seed) for seed in range(3)]
    for content in (b"one", b"another"):  # a second sweep on the same cluster
        with DaskPool(cluster.scheduler_address, {"a": content, "b": b""}) as pool:
            found = list(pool.run(pool.with_files(sweep_fakes.task_with_files), tasks))
        assert sorted(row["seed"] for _, row in found) == [0, 1, 2]
        assert all(task.seed == row["seed"] for task, row in found)
        assert {row["vacant"] for _, row in found} == {f"a {content.decode()}, b "}


def test_rows_are_those_of_this_machine(tmp_path, cluster, monkeypatch):
    weights = save_untrained(tmp_path)
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    asked = {"episodes": 4, "weights": weights, "disturbance": ["none", "B"]}
    assert sweep.main(SweepArguments(scheduler=cluster.scheduler_address, out=tmp_path / "cluster", **asked)) == 0
    monkeypatch.setattr(sweep, "Pool", lambda workers: Pool(0))
    assert sweep.main(SweepArguments(out=tmp_path / "here", **asked)) == 0
    assert without_times(tmp_path / "cluster") == without_times(tmp_path / "here")


def fail(job):
    raise RuntimeError(f"{job} fell off")


def test_what_a_job_raises_is_raised_or_a_result(cluster):
    with DaskPool(cluster.scheduler_address, {}) as pool:
        found = list(pool.run(fail, ["the arm"], given_up=lambda job, error: f"{job}: {error}"))
        assert found == [("the arm", "the arm: the arm fell off")]
        with pytest.raises(RuntimeError, match="the arm fell off"):
            list(pool.run(fail, ["the arm"]))


def test_dead_workers_are_replaced(tmp_path):
    tasks = [make_task(seed) for seed in range(8)]
    quiet = {"distributed.scheduler.allowed-failures": 1, "distributed.scheduler.worker-saturation": 1.0}
    with (
        dask.config.set(quiet),
        LocalCluster(processes=True, **LOCAL) as cluster,
        DaskPool(cluster.scheduler_address, {}) as pool,
    ):
        found = {t.seed: row for t, row in pool.run(partial(sweep_fakes.dying_task, tmp_path), tasks[1:], error_row)}
        assert {path.name for path in tmp_path.iterdir()} == {tasks[5].key}
        assert sorted(found) == list(range(1, 8))
        assert all(row["error"] is None for row in found.values())
        # Who stands behind a task that kills every worker is not taken for one that does.
        found = {t.seed: row for t, row in pool.run(partial(sweep_fakes.deadly_task, tmp_path), tasks, error_row)}
        assert [seed for seed, row in sorted(found.items()) if row["error"] is not None] == [0]
        assert "KilledWorker" in found[0]["error"]


def test_results_that_died_with_their_worker_are_waited_for(monkeypatch):
    """A result is finished, and lost before it is fetched, when the next task kills the worker."""

    class Future:
        def __init__(self, key, *statuses):
            self.key, self._statuses = key, list(statuses)

        @property
        def status(self):
            return self._statuses[0]

        def result(self):
            assert self.status == "finished"
            return self.key

        def release(self):
            pass

    class Completed(list):
        def __iter__(self):
            while self:
                yield self.pop(0)

        def add(self, future):
            future._statuses.pop(0)
            self.append(future)

    futures = [Future(0, "lost", "pending", "finished"), Future(1, "cancelled"), Future(2, "finished")]
    monkeypatch.setattr(cluster_module, "as_completed", Completed)
    pool = DaskPool.__new__(DaskPool)
    pool._client = type("Client", (), {"map": lambda self, function, jobs, pure: futures})()
    assert list(pool.run(None, "abc")) == [("c", 2), ("a", 0)]


def test_no_scheduler():
    with pytest.raises(InputError, match="no Dask scheduler at nonsense://1"):
        DaskPool("nonsense://1", {})
