"""Sweeps: what is on disk after a kill, a death, an error; that a second start changes nothing; what is refused."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from functools import partialmethod
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from diagrams import sweep
from diagrams.episodes import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.record import find_records, load_record
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import SEED_BASE, SEEDS_APART
from diagrams.sweeps.plan import SweepArguments
from diagrams.sweeps.table import SCHEMA
from models.command_line import ROOT
from models.errors import InputError
from models.files.container import WeightsError
from tests.diagrams import sweep_fakes
from tests.diagrams.untrained import save_untrained

FAKE_SWEEP = Path(__file__).parent / "sweep_fakes.py"
# As pick_place.py --json, the training seed, the failure kind and the error.
FIELDS = {
    "seed", "rnn", "detector", "disturbance", "can_xy", "vacant", "picked", "placed", "home", "success", "switched",
    "detection_delay_s", "false_switches", "returned", "resumed", "switch_success", "alpha_max_before", "sim_seconds",
    "wall_seconds", "realtime_factor", "weights_hash", "training_seed", "failure", "switch_failure", "error",
}  # fmt: skip
TIMES = ("wall_seconds", "realtime_factor")  # the other columns are the same for the same weights and seeds


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


@pytest.fixture
def in_this_process(monkeypatch):
    """No worker is started: what tests replace is seen."""
    monkeypatch.setattr(sweep, "Pool", lambda workers: Pool(0))


@pytest.fixture
def faked(in_this_process, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)


def run(weights, out, **changes):
    arguments = {"episodes": 6, "disturbance": ["none", "B"], "weights": weights, "out": out}
    return sweep.main(SweepArguments(**(arguments | changes)))


def table(folder):
    return pq.read_table(folder / "episodes.parquet").to_pylist()


def without_times(folder):
    return [{name: value for name, value in row.items() if name not in TIMES} for row in table(folder)]


def test_a_decided_comparison_ends(weights, tmp_path, in_this_process, monkeypatch, capsys):
    """And started again it stays ended; the other disturbance goes on to its last episode."""
    asked = []

    def run_task(folder, task):
        asked.append(task)
        done = task.detector == "recall" or task.disturbance == "none"
        return sweep_fakes.outcome_row(folder, task) | {"success": done}

    monkeypatch.setattr(sweep, "run_task", run_task)
    given = dict(episodes=10, detector=["recall", "never"], stop_when_decided=True)
    assert run(weights, tmp_path, **given) == 0
    assert [sum(task.disturbance == kind for task in asked) for kind in ("none", "B")] == [20, 14]
    assert "B: decided, e = 26.8" in capsys.readouterr().out
    assert len(table(tmp_path)) == 34
    asked.clear()
    assert run(weights, tmp_path, **given) == 0
    assert not asked
    for wrong in ({"detector": ["recall"]}, {"until": "switching"}, {"gamma": [3.0, 4.0]}):
        with pytest.raises(InputError, match="--stop-when-decided compares the tasks of two controllers"):
            run(weights, tmp_path / "other", **given | wrong)


def start(out, weights, *arguments):
    command = [sys.executable, FAKE_SWEEP, "--out", out, "--weights", weights, "--episodes", "16", *arguments]
    return subprocess.Popen(
        [*map(str, command), "--disturbance", "none", "A"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


def test_killed_and_resumed_sweep_ends_as_one_that_was_left_alone(tmp_path, weights):
    whole = start(tmp_path / "whole", weights, "--workers", "1")
    assert whole.wait(120) == 0, whole.stderr.read()

    out, rows = tmp_path / "killed", tmp_path / "killed" / "rows.jsonl"
    first = start(out, weights, "--workers", "2")
    deadline = time.monotonic() + 100
    while not rows.exists() or rows.read_bytes().count(b"\n") < 6:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    before = rows.read_bytes()
    done = before.count(b"\n") - 1  # the first line is the fingerprint
    assert 5 <= done < 32
    rows.write_bytes(before + b'{"key": "torn')  # what a kill in the middle of a row leaves

    again = start(out, weights, "--workers", "2")
    assert again.wait(120) == 0, again.stderr.read()
    assert f"32 episodes, {done} of them done" in again.stdout.read()
    assert rows.read_bytes().startswith(before)
    assert without_times(out) == without_times(tmp_path / "whole")  # also: two workers and one
    cells = [json.loads((folder / "summary.json").read_text())["cells"] for folder in (out, tmp_path / "whole")]
    for one, other in zip(*cells, strict=True):
        assert {k: v for k, v in one.items() if k not in TIMES} == {k: v for k, v in other.items() if k not in TIMES}


def test_rows_are_paired_ordered_and_whole(tmp_path, weights, faked):
    assert run(weights, tmp_path, gamma=[3.0, 40.0]) == 0
    written = pq.read_table(tmp_path / "episodes.parquet")
    assert written.schema.equals(SCHEMA)
    assert set(written.column_names) >= FIELDS
    rows = written.to_pylist()
    seeds = [SEED_BASE["evaluation"] + i for i in range(6)]
    assert [(r["gamma"], r["disturbance"], r["seed"]) for r in rows] == [
        (gamma, kind, seed) for gamma in (3.0, 40.0) for kind in ("none", "B") for seed in seeds
    ]
    assert all(len(r["weights_hash"]) == len(r["encoder_hash"]) == 64 for r in rows)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [(c["gamma"], c["disturbance"], c["task"]["n"]) for c in summary["cells"]] == [
        (3.0, "none", 6), (3.0, "B", 6), (40.0, "none", 6), (40.0, "B", 6),
    ]  # fmt: skip


def test_nothing_missing_starts_no_worker(tmp_path, weights, faked, monkeypatch):
    assert run(weights, tmp_path) == 0
    before = (tmp_path / "episodes.parquet").read_bytes()
    monkeypatch.setattr(sweep, "Pool", None)
    assert run(weights, tmp_path) == 0
    assert (tmp_path / "episodes.parquet").read_bytes() == before


def test_more_may_be_asked_of_the_same_folder(tmp_path, weights, faked, capsys):
    assert run(weights, tmp_path, disturbance=["B"]) == 0
    first = table(tmp_path)
    assert run(weights, tmp_path, episodes=7, gamma=[], disturbance=["none", "B"]) == 0
    assert "14 episodes, 6 of them done" in capsys.readouterr().out
    rows = table(tmp_path)
    assert len(rows) == 14
    assert rows[7:13] == first


def test_errors_are_rows_with_their_traceback(tmp_path, weights, in_this_process, monkeypatch, capsys):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.failing_task)
    assert run(weights, tmp_path, disturbance=["none"]) == 1
    rows = table(tmp_path)
    failed = "RuntimeError: the arm fell off"
    assert [r["error"] for r in rows] == [failed, None, None, None, failed, None]
    assert [r["success"] or r["switch_success"] for r in rows if r["error"]] == [False, False]
    assert "sweep_fakes.py" in rows[0]["traceback"]
    assert "in failing_task" in rows[0]["traceback"]
    assert rows[1]["traceback"] is None
    cell = json.loads((tmp_path / "summary.json").read_text())["cells"][0]
    assert (cell["errors"], cell["task"]["n"], cell["task"]["failures"]["error"]) == (2, 6, 2)
    assert "2 of 6 episodes raised an error" in capsys.readouterr().err
    # A second start keeps them, and its exit code too; only when asked it tries again.
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(weights, tmp_path, disturbance=["none"]) == 1
    assert run(weights, tmp_path, disturbance=["none"], retry_errors=True) == 0


def test_an_episode_under_which_workers_die_is_no_result(tmp_path, weights, monkeypatch):
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.deadly_task)
    asked = {"episodes": 3, "disturbance": ["none"], "workers": 1}
    with pytest.raises(InputError, match=r"^1 episodes lost their worker.*: \S+-none-\d+: give each worker"):
        run(weights, tmp_path, **asked)
    assert not (tmp_path / "episodes.parquet").exists()
    rows = tmp_path / "rows.jsonl"
    _, *stored = [json.loads(line) for line in rows.read_text().splitlines()]
    assert [line["row"]["error"] for line in stored] == [None, None]
    # A row of it that an older program stored is none either.
    monkeypatch.setattr(sweep, "run_task", sweep_fakes.outcome_row)
    assert run(weights, tmp_path, **asked) == 0
    *before, last = rows.read_text().splitlines(keepends=True)
    dead = json.loads(last)
    dead["row"] |= {"error": "KilledWorker: 4 workers died", "success": False}
    rows.write_text("".join(before) + json.dumps(dead) + "\n")
    assert run(weights, tmp_path, **asked) == 0
    assert [row["error"] for row in table(tmp_path)] == [None] * 3
    assert len(rows.read_text().splitlines()) == 5


def test_other_weights_do_not_mix(tmp_path, weights, faked):
    assert run(weights, tmp_path / "out") == 0
    (tmp_path / "weights").mkdir()
    others = save_untrained(tmp_path / "weights", gamma=20.0)
    with pytest.raises(InputError, match="episodes of other weights"):
        run(others, tmp_path / "out")


def test_another_world_or_code_does_not_mix(tmp_path, weights, faked, monkeypatch):
    assert run(weights, tmp_path / "out") == 0
    world = tmp_path / "soft.yaml"
    world.write_text("servo: {finger_stiffness: 1500.0}\n")
    with pytest.raises(InputError, match=r"world.servo.finger_stiffness \(2000.0, now 1500.0\): choose another --out"):
        run(weights, tmp_path / "out", world=world)
    assert run(weights, tmp_path / "soft", world=world) == 0
    code = fingerprint.code_hash()
    monkeypatch.setattr(fingerprint, "code_hash", lambda: "changed")
    with pytest.raises(InputError, match=rf"another code \({code}, now changed\)"):
        run(weights, tmp_path / "out")


def test_a_table_is_not_overwritten_without_its_rows(tmp_path, weights):
    (tmp_path / "episodes.parquet").write_bytes(b"hours of work")
    with pytest.raises(InputError, match="table without its rows"):
        run(weights, tmp_path)


@pytest.mark.parametrize("name", ["episodes.parquet", "summary.json"])
def test_what_is_no_file_is_not_written_to(tmp_path, weights, name):
    (tmp_path / name).symlink_to("/dev/zero")
    (tmp_path / "rows.jsonl").touch()
    with pytest.raises(InputError, match=rf"{name} is a pipe or a device, no plain file: choose another --out"):
        run(weights, tmp_path)


def test_a_missing_package_is_said_before_anything_runs(tmp_path, weights, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "scipy" else found(name))
    with pytest.raises(ModuleNotFoundError, match="scipy"):
        run(weights, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_remedies_are_compared_on_validation_scenes(tmp_path, weights, faked):
    assert run(weights, tmp_path, purpose="validation", seed=1) == 0
    seeds = {row["seed"] for row in table(tmp_path)}
    assert seeds == {SEED_BASE["validation"] + SEEDS_APART + i for i in range(6)}


def test_real_episodes(tmp_path, weights, in_this_process, monkeypatch):
    """All of it with untrained networks, 1.5 s an episode: their detector notices everything at once."""
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=1.5))
    assert (
        run(weights, tmp_path, episodes=2, disturbance=["none"], gamma=[1e12, 10.0], keep_records=True, mcap=True) == 0
    )
    rows = table(tmp_path)
    assert [(r["switched"], r["switch_failure"]) for r in rows] == [(False, None)] * 2 + [(True, "false switch")] * 2
    assert [r["sim_seconds"] for r in rows] == [1.5] * 4
    assert all(r["error"] is None and r["error_peak_normal"] > 10.0 and r["error_peak_disturbed"] is None for r in rows)
    # Alpha at most 1/2 in the first, no disturbance in any.
    false_switch = [row["robustness_no_false_switch"] for row in rows]
    assert [value >= 0.0 for value in false_switch] == [True] * 2 + [False] * 2
    assert {row["robustness_notices"] for row in rows} == {5.0}
    assert rows[0]["can_xy"] == rows[2]["can_xy"] != rows[1]["can_xy"]
    records = [load_record(path) for path in find_records([tmp_path / "records"])]
    assert len(records) == 4
    assert all(len(record.time) == 15 and record.picture_ticks.tolist() == [0, 5, 10] for record, _ in records)
    assert {tuple(outcome["can_xy"]) for _, outcome in records} == {tuple(row["can_xy"]) for row in rows}
    assert {path.stem for path in (tmp_path / "mcap").glob("*.mcap")} == {
        path.stem for path in (tmp_path / "records").glob("*.npz")
    }
    for path in (tmp_path / "mcap").iterdir():
        with path.open("rb") as file:
            counts = make_reader(file).get_summary().statistics.channel_message_counts.values()
        assert sorted(counts)[1:] == [15] * 5 + [30]  # a picture a tick, two of transforms; but for the events


def test_real_faults(tmp_path, weights, in_this_process, monkeypatch):
    """Of a fault that does not take the arm, switching and requirements are not judged."""
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=1.0))
    kinds = dict(disturbance=["none", "friction"], severity=[0.5, 1.0])
    assert run(weights, tmp_path, episodes=1, gamma=[1e12], **kinds) == 0
    rows = table(tmp_path)
    assert [(r["disturbance"], r["severity"], r["error"]) for r in rows] == [
        ("none", None, None), ("friction", 0.5, None), ("friction", 1.0, None)
    ]  # fmt: skip
    for row, judged in zip(rows, (True, False, False), strict=True):
        found = [value for name, value in row.items() if name.startswith("robustness_")]
        assert [value is not None for value in found] == [judged] * 9
        assert (row["false_switches"] is not None) is judged


def test_a_file_that_is_asked_for_later_is_made(tmp_path, weights, faked, monkeypatch, capsys):
    def with_file(folder, task):
        return sweep_fakes.outcome_row(folder, task) | ({"mcap": b"ticks"} if task.files else {})

    monkeypatch.setattr(sweep, "run_task", with_file)
    assert run(weights, tmp_path) == 0
    before = without_times(tmp_path)
    assert run(weights, tmp_path, mcap=True) == 0
    assert len([*(tmp_path / "mcap").glob("*.mcap")]) == 12
    assert without_times(tmp_path) == before
    next((tmp_path / "mcap").glob("*.mcap")).unlink()
    capsys.readouterr()
    assert run(weights, tmp_path, mcap=True) == 0
    assert "12 episodes, 11 of them done" in capsys.readouterr().out
    assert len([*(tmp_path / "mcap").glob("*.mcap")]) == 12


def test_a_smaller_sweep_does_not_take_the_place_of_a_larger_one(tmp_path, weights, faked):
    assert run(weights, tmp_path) == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(InputError, match=r"holds 6 episodes that are not asked for.*choose another --out"):
        run(weights, tmp_path, disturbance=["none"])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("changes", "named"), [({"sim_seconds": "long"}, "long"), ({"void": None}, None), ({}, "no void")]
)
def test_a_row_of_another_version_is_refused(tmp_path, weights, faked, changes, named):
    assert run(weights, tmp_path) == 0
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    entry = json.loads(lines[3])
    entry["row"] |= changes
    if not changes:
        del entry["row"]["void"]
    lines[3] = json.dumps(entry)
    (tmp_path / "rows.jsonl").write_text("\n".join(lines) + "\n")
    if named is None:
        assert run(weights, tmp_path) == 0
        return
    with pytest.raises(InputError, match=rf"rows\.jsonl has a row that is none, {entry['key']} .*{named}"):
        run(weights, tmp_path)


def test_episodes_end_with_the_switching_where_that_is_asked(tmp_path, weights, in_this_process, monkeypatch):
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=1.5))
    assert run(weights, tmp_path, episodes=1, disturbance=["none"], gamma=[1e12, 10.0], until="switching") == 0
    rows = table(tmp_path)
    assert [(r["success"], r["failure"], r["switch_failure"]) for r in rows] == [
        (None, None, None),
        (None, None, "false switch"),
    ]
    assert rows[0]["sim_seconds"] == 1.5 > rows[1]["sim_seconds"]
    assert ["task" in cell for cell in json.loads((tmp_path / "summary.json").read_text())["cells"]] == [False, False]


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"rnn": ["rnn"]}, InputError, "no network 'rnn' in .*: choose from lstm, or train"),
        ({"rnn": []}, InputError, "no rnn given"),
        ({"detector": ["svm"]}, InputError, "no detector 'svm'.*recall, knn, subspace"),
        ({"disturbance": ["none", "C"]}, InputError, "no disturbance 'C'"),
        ({"recovery": "panic"}, InputError, "no recovery 'panic'.*planned, backoff"),
        ({"episodes": 0}, InputError, "number of episodes 0.*from 1"),
        ({"seed": -1}, InputError, "seed -1"),
        ({"gamma": [3.0, float("nan")]}, InputError, "gamma nan is out of range"),
        ({"keep_records": True, "until": "switching"}, InputError, "--keep-records keeps whole episodes"),
        ({"mcap": True, "until": "switching"}, InputError, "--mcap keeps whole episodes"),
        ({"gamma": [0.0]}, InputError, "gamma 0.0 is out of range"),
        ({"workers": 0}, InputError, "number of workers 0"),
        ({"training_seeds": [-1]}, InputError, "training seed -1"),
        ({"training_seeds": []}, InputError, "no training seeds given"),
        ({"training_seeds": [3]}, InputError, "no network 'lstm' of training seed 3"),
        ({"rnn": ["gru"]}, InputError, "no network 'gru'"),
        ({"detector": ["recall", "never"], "gamma": [3.0]}, InputError, "--gamma says nothing to the detector 'never'"),
        ({"detector": ["knn"]}, WeightsError, "knn.safetensors.*does not exist"),
        ({"world": Path("nowhere.yaml")}, InputError, "no world file nowhere.yaml"),
        ({"out": Path("/dev/null/out")}, InputError, "cannot be written"),
        ({"scheduler": "nonsense://1"}, InputError, "no Dask scheduler at nonsense://1"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(tmp_path, weights, changes, error, named):
    arguments = {"weights": weights, "out": tmp_path / "out"}
    with pytest.raises(error, match=f"(?s){named}"):
        sweep.main(SweepArguments(**(arguments | changes)))
    assert not (tmp_path / "out").exists()


def test_bad_input_has_code_2_and_one_line(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "diagrams" / "sweep.py"), "--weights", "nowhere"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=100,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: nowhere/encoder.onnx")


def test_options():
    words = "--rnn lstm gru --detector a.b:C --disturbance none --gamma 3 20 --keep-records"
    asked = sweep.parse(words.split())
    assert (asked.rnn, asked.detector, asked.disturbance) == (["lstm", "gru"], ["a.b:C"], ["none"])
    assert (asked.gamma, asked.keep_records, asked.training_seeds) == ([3.0, 20.0], True, [0])
