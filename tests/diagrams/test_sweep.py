"""Sweeps: what is on disk after a kill, a death, an error; that a second start changes nothing; what is refused."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import dask
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster

from diagrams import sweep
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.record import find_records, load_record
from diagrams.episodes.sampling import SEED_BASE, SEEDS_APART
from diagrams.sweep import SweepArguments, connect, execute
from diagrams.sweeps import task as sweep_task
from diagrams.sweeps.store import SCHEMA, TIMES, EpisodeStore
from diagrams.sweeps.task import Task, error_row, run_in
from models.command_line import ROOT
from models.errors import InputError
from models.files.weights import WeightsError
from tests.diagrams import sweep_fakes
from tests.diagrams.untrained import save_untrained

FAKE_SWEEP = Path(__file__).parent / "sweep_fakes.py"
# As pick_place.py --json, the training seed, the failure kind and the error.
FIELDS = {
    "seed", "rnn", "detector", "disturbance", "can_xy", "vacant", "picked", "placed", "home", "success", "switched",
    "detection_delay_s", "false_switches", "returned", "resumed", "switch_success", "alpha_max_before", "sim_seconds",
    "wall_seconds", "realtime_factor", "weights_hash", "training_seed", "failure", "switch_failure", "error",
}  # fmt: skip


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="module")
def cluster():
    """A cluster with its workers in this process: it starts at once, and sees what tests replace."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


def make_task(seed=0, disturbance="none", weights_hash="", rnn="lstm", gamma=None, until="task"):
    return Task(rnn, 0, "recall", gamma, disturbance, seed, "bundle", weights_hash, "", None, until=until)


def without_times(folder):
    return pq.read_table(folder / "episodes.parquet").drop_columns(list(TIMES)).to_pylist()


def start(out, weights, *arguments):
    command = [sys.executable, str(FAKE_SWEEP), "--out", out, "--weights", weights, "--episodes", "16", *arguments]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


def test_killed_and_resumed_sweep_ends_as_one_that_was_left_alone(tmp_path, weights):
    whole = start(tmp_path / "whole", weights, "--disturbance", "none", "A", "--workers", "1")
    assert whole.wait(120) == 0, whole.stderr.read()

    out = tmp_path / "killed"
    first = start(out, weights, "--disturbance", "none", "A", "--workers", "2")
    deadline = time.monotonic() + 100
    while len(list(out.glob("parts/*.parquet"))) < 5:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    before = {path: path.read_bytes() for path in out.glob("parts/*.parquet")}
    assert 5 <= len(before) < 32
    (out / "parts" / "torn.partial").write_bytes(b"PAR1")  # what a kill in the middle of a part leaves

    again = start(out, weights, "--disturbance", "none", "A", "--workers", "2")
    assert again.wait(120) == 0, again.stderr.read()
    assert f"32 episodes, {len(before)} of them done" in again.stdout.read()
    assert all(path.read_bytes() == content for path, content in before.items())
    assert without_times(out) == without_times(tmp_path / "whole")  # also: two workers and one
    cells = [json.loads((folder / "summary.json").read_text())["cells"] for folder in (out, tmp_path / "whole")]
    for one, other in zip(*cells, strict=True):
        assert {k: v for k, v in one.items() if k not in TIMES} == {k: v for k, v in other.items() if k not in TIMES}


def run(cluster, weights, out, **changes):
    arguments = {"episodes": 6, "disturbance": ["none", "B"], "scheduler": cluster.scheduler_address}
    return sweep.main(SweepArguments(weights=weights, out=out, **(arguments | changes)))


def test_rows_are_paired_ordered_and_whole(tmp_path, weights, cluster, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(cluster, weights, tmp_path, gamma=[3.0, 40.0]) == 0
    table = pq.read_table(tmp_path / "episodes.parquet")
    assert table.schema.equals(SCHEMA)
    assert set(table.column_names) >= FIELDS
    rows = table.to_pylist()
    seeds = [SEED_BASE["evaluation"] + i for i in range(6)]
    assert [(r["gamma"], r["disturbance"], r["seed"]) for r in rows] == [
        (gamma, kind, seed) for gamma in (3.0, 40.0) for kind in ("none", "B") for seed in seeds
    ]
    assert all(len(r["weights_hash"]) == len(r["encoder_hash"]) == 64 for r in rows)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [(c["gamma"], c["disturbance"], c["task"]["n"]) for c in summary["cells"]] == [
        (3.0, "none", 6), (3.0, "B", 6), (40.0, "none", 6), (40.0, "B", 6),
    ]  # fmt: skip


def test_nothing_missing_starts_no_cluster(tmp_path, weights, cluster, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(cluster, weights, tmp_path) == 0
    before = (tmp_path / "episodes.parquet").read_bytes()
    monkeypatch.setattr(sweep, "connect", None)
    assert run(cluster, weights, tmp_path) == 0
    assert (tmp_path / "episodes.parquet").read_bytes() == before


def test_errors_are_rows_and_say_so(tmp_path, weights, cluster, monkeypatch, capsys):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.raising_task)
    assert run(cluster, weights, tmp_path, disturbance=["none"]) == 1
    rows = pq.read_table(tmp_path / "episodes.parquet").to_pylist()
    assert [r["error"] for r in rows] == ["RuntimeError: the arm fell off", None, None, None] + [
        "RuntimeError: the arm fell off", None,
    ]  # fmt: skip
    assert [r["success"] or r["switch_success"] for r in rows if r["error"]] == [False, False]
    cell = json.loads((tmp_path / "summary.json").read_text())["cells"][0]
    assert (cell["errors"], cell["task"]["n"], cell["task"]["failures"]["error"]) == (2, 6, 2)
    assert "2 of 6 episodes raised an error" in capsys.readouterr().err
    # A second start keeps them, and its exit code too; only when asked it tries again.
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(cluster, weights, tmp_path, disturbance=["none"]) == 1
    assert run(cluster, weights, tmp_path, disturbance=["none"], retry_errors=True) == 0


def test_other_weights_do_not_mix(tmp_path, weights, cluster, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(cluster, weights, tmp_path / "out") == 0
    (tmp_path / "weights").mkdir()
    others = save_untrained(tmp_path / "weights", gain=0.2)
    with pytest.raises(InputError, match="episodes of other weights"):
        run(cluster, others, tmp_path / "out")


def test_remedies_are_compared_on_validation_scenes(tmp_path, weights, cluster, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(cluster, weights, tmp_path, purpose="validation", seed=1) == 0
    seeds = {row["seed"] for row in pq.read_table(tmp_path / "episodes.parquet").to_pylist()}
    assert seeds == {SEED_BASE["validation"] + SEEDS_APART + i for i in range(6)}


def test_a_file_under_another_name_is_no_other_network(tmp_path, weights):
    for name in ("cae", "lstm"):
        shutil.copy(weights / f"{name}.safetensors", tmp_path)
    for name in ("gru", "lstm-1"):
        shutil.copy(weights / "lstm.safetensors", tmp_path / f"{name}.safetensors")
    with pytest.raises(WeightsError, match=r"gru.safetensors.*holds the network 'lstm', not 'gru'"):
        sweep.main(SweepArguments(weights=tmp_path, rnn=["gru"], out=tmp_path / "out"))
    with pytest.raises(WeightsError, match=r"lstm-1.safetensors.*is the same file as lstm.safetensors"):
        sweep.main(SweepArguments(weights=tmp_path, training_seeds=[0, 1], out=tmp_path / "out"))


def test_dead_workers_are_replaced(tmp_path):
    tasks = [make_task(seed, weights_hash=str(tmp_path)) for seed in range(8)]
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}), connect(None, 1) as client:
        found = {task.seed: row for task, row in execute(client, sweep_fakes.dying_task, tasks[1:])}
        assert {path.name for path in tmp_path.iterdir()} == {tasks[5].key}
        assert sorted(found) == list(range(1, 8))
        assert all(row["error"] is None for row in found.values())
        # Who stands behind a task that kills every worker is not taken for one that does.
        found = {task.seed: row for task, row in execute(client, sweep_fakes.deadly_task, tasks)}
        assert [seed for seed, row in sorted(found.items()) if row["error"] is not None] == [0]
        assert "KilledWorker" in found[0]["error"]


def test_rows_that_died_with_their_worker_are_waited_for(monkeypatch):
    """A row is finished, and lost before it is fetched, when the next task kills the worker."""

    class Future:
        def __init__(self, task, *statuses):
            self.key, self._statuses = task.key, list(statuses)

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

    tasks = [make_task(seed) for seed in range(3)]
    futures = [
        Future(tasks[0], "lost", "pending", "finished"),
        Future(tasks[1], "cancelled"),
        Future(tasks[2], "finished"),
    ]
    monkeypatch.setattr(sweep, "as_completed", Completed)
    client = type("Client", (), {"map": lambda self, run, tasks, pure: futures})()
    assert list(execute(client, None, tasks)) == [(tasks[2], tasks[2].key), (tasks[0], tasks[0].key)]


def test_real_episodes(tmp_path, weights, cluster, monkeypatch):
    """The whole way with untrained networks, 1.5 s an episode: their detector notices everything at once."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    assert run(cluster, weights, tmp_path, episodes=2, disturbance=["none"], gamma=[1e12, 10.0], log=True) == 0
    rows = pq.read_table(tmp_path / "episodes.parquet").to_pylist()
    assert [(r["switched"], r["switch_failure"]) for r in rows] == [(False, None)] * 2 + [(True, "false switch")] * 2
    assert [r["sim_seconds"] for r in rows] == [1.5] * 4
    assert all(r["error"] is None and r["error_peak_normal"] > 10.0 and r["error_peak_disturbed"] is None for r in rows)
    assert rows[0]["can_xy"] == rows[2]["can_xy"] != rows[1]["can_xy"]
    records = [load_record(path) for path in find_records([tmp_path / "records"])]
    assert len(records) == 4
    assert all(len(record.time) == 15 for record, _ in records)
    assert {tuple(outcome["can_xy"]) for _, outcome in records} == {tuple(row["can_xy"]) for row in rows}


def test_episodes_end_with_the_switching_where_that_is_asked(tmp_path, weights, cluster, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    asked = {"episodes": 1, "disturbance": ["none"], "gamma": [1e12, 10.0], "until": "switching"}
    assert run(cluster, weights, tmp_path, **asked) == 0
    rows = pq.read_table(tmp_path / "episodes.parquet").to_pylist()
    assert [(r["success"], r["failure"], r["switch_failure"]) for r in rows] == [
        (None, None, None),
        (None, None, "false switch"),
    ]
    assert rows[0]["sim_seconds"] == 1.5 > rows[1]["sim_seconds"]
    assert ["task" in cell for cell in json.loads((tmp_path / "summary.json").read_text())["cells"]] == [False, False]


def test_whatever_an_episode_raises_is_its_row(tmp_path, weights, monkeypatch):
    assert "WeightsError" in run_in(tmp_path, make_task())["error"]

    def leave(folder):
        raise SystemExit("the plant has sampled output ports")

    monkeypatch.setattr(sweep_task, "_worker_of", leave)
    row = run_in(weights, make_task(7, "A"))
    assert row["error"] == "SystemExit: the plant has sampled output ports"
    assert (row["seed"], row["disturbance"], row["success"]) == (7, "A", False)


def test_store_knows_what_is_there(tmp_path):
    store, tasks = EpisodeStore(tmp_path / "new"), [make_task(seed, gamma=3.0) for seed in range(3)]
    store.add(tasks[0].key, sweep_fakes.outcome_row(tasks[0]))
    store.add(tasks[1].key, error_row(tasks[1], ValueError("no")))
    rows = store.read(task.key for task in tasks)
    assert [rows[task.key]["seed"] for task in tasks[:2]] == [0, 1]
    assert tasks[2].key not in rows
    assert rows[tasks[1].key]["error"] == "ValueError: no"
    (tmp_path / "new" / "parts" / f"{tasks[2].key}.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"damaged.*delete it"):
        store.read([tasks[2].key])


def test_keys_tell_all_episodes_apart():
    tasks = [
        make_task(s, d, gamma=g, rnn=r, until=u)
        for s in (0, 1)
        for d in "AB"
        for g in (None, 3.0, 3.5)
        for r in ("lstm", "gru")
        for u in ("task", "switching")
    ]
    assert len({task.key for task in tasks}) == len(tasks)


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"rnn": ["rnn"]}, InputError, "no rnn 'rnn'.*lstm, gru, mtrnn"),
        ({"detector": ["svm"]}, InputError, "no detector 'svm'.*recall, knn, subspace"),
        ({"disturbance": ["none", "C"]}, InputError, "no disturbance 'C'"),
        ({"episodes": 0}, InputError, "number of episodes 0.*from 1"),
        ({"seed": -1}, InputError, "seed -1"),
        ({"gamma": [3.0, float("nan")]}, InputError, "gamma nan is out of range"),
        ({"log": True, "until": "switching"}, InputError, "--log keeps whole episodes"),
        ({"gamma": [0.0]}, InputError, "gamma 0.0 is out of range"),
        ({"workers": 0}, InputError, "number of workers 0"),
        ({"training_seeds": [-1]}, InputError, "training seed -1"),
        ({"training_seeds": []}, InputError, "no training seed"),
        ({"training_seeds": [3]}, WeightsError, "lstm-3.safetensors.*does not exist"),
        ({"rnn": ["gru"]}, WeightsError, "gru.safetensors.*does not exist"),
        ({"detector": ["knn"]}, WeightsError, "knn.safetensors.*does not exist"),
        ({"out": Path("/dev/null/out")}, InputError, "cannot be written"),
        ({"scheduler": "nonsense://1"}, InputError, "no Dask scheduler at nonsense://1"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(tmp_path, weights, changes, error, named):
    arguments = {"weights": weights, "out": tmp_path / "out"}
    with pytest.raises(error, match=f"(?s){named}"):
        sweep.main(SweepArguments(**(arguments | changes)))


def test_bad_input_has_code_2_and_one_line(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "diagrams" / "sweep.py"), "--weights", "nowhere"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=100, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: nowhere/cae.safetensors")
