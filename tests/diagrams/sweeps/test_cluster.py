"""A Dask cluster with the pool's face: files reach its workers, dead ones are replaced."""

import itertools
import os
import re
import socket
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import dask
import pytest
from distributed import LocalCluster, Security

from diagrams import sweep
from diagrams.episodes.pool import Pool, WorkerDied
from diagrams.monitors.bench_plan import BenchArguments
from diagrams.sweeps import cluster as cluster_module
from diagrams.sweeps.cluster import DaskPool
from diagrams.sweeps.plan import SweepArguments
from diagrams.sweeps.task import believed, error_row
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams import sweep_fakes
from tests.diagrams.sweep_fakes import make_task
from tests.diagrams.test_sweep import without_times
from tests.diagrams.untrained import save_untrained

LOCAL = {"n_workers": 1, "threads_per_worker": 1, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
TLS = {"tls_ca": Path("ca"), "tls_cert": Path("cert"), "tls_key": Path("key")}


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


def test_what_a_job_raises_is_raised(cluster):
    with DaskPool(cluster.scheduler_address, {}) as pool, pytest.raises(RuntimeError, match="the arm fell off"):
        list(pool.run(fail, ["the arm"], given_up=lambda job, error: "no worker died"))


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
        def __init__(self, futures, loop):
            super().__init__(futures)

        def add(self, future):
            future._statuses.pop(0)
            self.append(future)

        def is_empty(self):
            return not self

        def has_ready(self):
            return True

        def __next__(self):
            return self.pop(0)

    futures = [Future(0, "lost", "pending", "finished"), Future(1, "cancelled"), Future(2, "finished")]
    clients = iter(
        type("Client", (), {"map": lambda self, f, jobs, pure, some=some: some, "loop": None, "close": int})()
        for some in (futures, [Future(1, "finished")])
    )
    monkeypatch.setattr(cluster_module, "as_completed", Completed)
    monkeypatch.setattr(DaskPool, "_connect", lambda self, patience: setattr(self, "_client", next(clients)))
    pool = DaskPool("nowhere", {})
    # What was cancelled was lost with the scheduler: it is asked for again.
    assert list(pool.run(None, "abc")) == [("c", 2), ("a", 0), ("b", 1)]


def test_what_accepts_and_never_answers_is_no_scheduler(monkeypatch):
    monkeypatch.setattr(cluster_module, "PATIENCE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=f"no Dask scheduler at {address} .*: check the address"):
            DaskPool(address, {})


def test_no_scheduler():
    with pytest.raises(InputError, match="no Dask scheduler at nonsense://1"):
        DaskPool("nonsense://1", {})


def test_a_configuration_that_dask_refuses_is_named():
    code = "from diagrams.sweeps.plan import SweepArguments as S\nfrom models.command_line import run\n"
    code += "run(lambda _: S(scheduler='tcp://127.0.0.1:1').require_cluster(), lambda: None)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "nonsense"},
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert re.fullmatch(r"error: Dask cannot use its configuration \(.*NONSENSE.*\): mend .*\n", done.stderr)


def elsewhere(found, **other):
    """`found`, but as it is for workers with `other`: these are threads of this process."""
    here = found()
    return lambda: here if threading.current_thread() is threading.main_thread() else here | other


@pytest.mark.parametrize("name", ["drake", "numpy", "onnxruntime", "opencv-python-headless", "Python", "code"])
def test_a_worker_of_another_version_is_refused(cluster, monkeypatch, name):
    here = cluster_module.versions()[name]
    with DaskPool(cluster.scheduler_address, {}) as pool:
        function = pool.with_files(sweep_fakes.outcome_row)
        monkeypatch.setattr(cluster_module, "versions", elsewhere(cluster_module.versions, **{name: "0.0"}))
        named = rf"^the worker tcp://[\d.:]+ has {name} 0.0, the sweep {here}: bring both to the same$"
        with pytest.raises(InputError, match=named):
            list(pool.run(function, [make_task()], error_row))  # as if it had come later
    with pytest.raises(InputError, match=named):
        DaskPool(cluster.scheduler_address, {})


def test_a_worker_without_this_program_is_refused(cluster, monkeypatch):
    def run(self, *_, **__):
        return {"tcp://worker": ModuleNotFoundError("No module named 'diagrams'")}

    monkeypatch.setattr(cluster_module.Client, "run", run)
    with pytest.raises(
        InputError, match=r"tcp://worker cannot run this program .No module named 'diagrams'.: start it"
    ):
        DaskPool(cluster.scheduler_address, {})


def test_a_worker_with_too_little_memory_is_refused(cluster, monkeypatch):
    monkeypatch.setattr(cluster_module, "MEMORY", 1e15)
    with pytest.raises(InputError, match=r"may use [\d.]+ GB of memory, an episode takes 1e.06: .*--memory-limit"):
        DaskPool(cluster.scheduler_address, {})


def test_a_cluster_without_workers_is_not_waited_for_in_silence(monkeypatch, capfd):
    monkeypatch.setattr(cluster_module, "WAIT", 1.0)
    with LocalCluster(processes=False, **LOCAL) as cluster:
        with DaskPool(cluster.scheduler_address, {}) as pool:
            cluster.scale(0)
            with pytest.raises(InputError, match=r"has had no worker for 1 s: start some .dask worker tcp://.*goes on"):
                list(pool.run(fail, ["the arm"]))
        with pytest.raises(InputError, match="has had no worker"):
            DaskPool(cluster.scheduler_address, {})
    assert capfd.readouterr().err.count("waiting for a worker at tcp://") == 2


def test_rows_of_workers_without_memory_are_not_believed():
    tasks = [make_task(seed) for seed in range(14)]
    errors = [WorkerDied("3 workers died"), MemoryError("no room")]
    died = [(task, error_row(task, errors[k % 2])) for k, task in enumerate(tasks)]
    lacking = [(task, error_row(task, ImportError("no foxglove"))) for task in tasks]
    finished = (tasks[2], {"error": None})
    raised = (tasks[2], error_row(tasks[2], RuntimeError("the arm fell off")))
    given = iter(died)
    for rows in (died[3:4], given):
        with pytest.raises(InputError, match="give each worker 1 GB of memory or more"):
            list(believed(rows))
    assert next(given) is died[3]  # after three nothing more is run
    with pytest.raises(
        InputError, match=r"none finished \(ImportError: no foxglove\): .*: bring its packages to the versions"
    ):
        list(believed(lacking))
    assert list(itertools.islice(believed(iter([*lacking[:2], finished])), 3)) == [*lacking[:2], finished]
    for other in (finished, raised):  # then it is these episodes: all others are run, and no more than ten are named
        given = believed([lacking[0], died[0], other, *died[3:6], finished, *died[6:], raised])
        assert list(itertools.islice(given, 4)) == [lacking[0], other, finished, raised]
        with pytest.raises(InputError) as refused:
            next(given)
        names = ", ".join(task.key for task, _ in [died[0], *died[3:12]])
        assert str(refused.value).startswith("12 episodes lost their worker, or had no memory left, (WorkerDied: 3")
        assert f"): {names} ...: give each worker 1 GB" in str(refused.value)
    assert list(believed([])) == []


@pytest.fixture(scope="module")
def authorities(tmp_path_factory):
    """Two, each with a certificate and its key, as files."""
    made = []
    for name in ("ours", "another"):
        folder, security = tmp_path_factory.mktemp(name), Security.temporary()
        contents = (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)
        made.append(tuple(folder / f"{part}.pem" for part in ("ca", "cert", "key")))
        for path, content in zip(made[-1], contents, strict=True):
            path.write_text(content)
    return made


def test_encrypted(authorities, monkeypatch):
    ours, another = authorities
    ca, cert, key = map(str, ours)
    both = {f"tls_{side}_{what}": file for side in ("scheduler", "worker", "client") for what, file in
            (("cert", cert), ("key", key))}  # fmt: skip
    security = Security(tls_ca_file=ca, require_encryption=True, **both)
    with LocalCluster(processes=False, security=security, **LOCAL | {"protocol": "tls"}) as cluster:
        assert cluster.scheduler_address.startswith("tls://")
        with DaskPool(cluster.scheduler_address, {"a": b"one"}, ours) as pool:
            found = list(pool.run(pool.with_files(sweep_fakes.task_with_files), [make_task()]))
            assert [row["vacant"] for _, row in found] == ["a one"]
        monkeypatch.setattr(cluster_module, "PATIENCE", 1.0)
        with pytest.raises(InputError, match=r"no Dask scheduler at tls://.*who signed --tls-cert"):
            DaskPool(cluster.scheduler_address, {}, another)
        with pytest.raises(InputError, match=r"no Dask scheduler at tcp://.*check the address"):
            DaskPool(cluster.scheduler_address.replace("tls", "tcp"), {})
    with pytest.raises(InputError, match="cannot be used for TLS"):
        DaskPool("tls://127.0.0.1:1", {}, (ours[0], ours[1], another[2]))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"scheduler": "tls://1:1"}, "tls://1:1 speaks TLS: give --tls-ca, --tls-cert, --tls-key"),
        ({"scheduler": "tls://1:1", "tls_ca": Path("ca")}, "--tls-ca alone will not do"),
        ({"scheduler": "tls://1:1", "tls_cert": Path("c"), "tls_key": Path("k")}, "--tls-cert and --tls-key alone"),
        ({"scheduler": "tcp://1:1", **TLS}, "--tls-ca is for a --scheduler at tls://..., not tcp://1:1"),
        (TLS, "--tls-ca is for a --scheduler at tls://..., not None"),
        ({"scheduler": "tls://1:1", **TLS}, "--tls-ca ca is no file"),
    ],
)
@pytest.mark.parametrize("arguments", [SweepArguments, BenchArguments])
def test_half_a_set_of_tls_files_is_refused(arguments, changes, named):
    with pytest.raises(InputError, match=named):
        arguments(**changes).check()
