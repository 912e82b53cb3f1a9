"""The bench: what it writes, that a kill changes no byte, what more may be asked for, what is refused; one real run."""

import functools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import average_precision_score, roc_auc_score

from diagrams import bench
from diagrams.episodes.pool import WorkerDied
from diagrams.episodes.rollout import Rollout
from diagrams.monitors import bench_fit, bench_task
from diagrams.monitors.bench_plan import BenchArguments
from diagrams.monitors.bench_task import run_bench_task
from diagrams.monitors.families import family_of
from diagrams.monitors.tapes import taped_and_recorded
from models.command_line import ROOT
from models.errors import InputError
from models.files.detectors import load_detector, save_detector
from tests.diagrams import bench_fakes
from tests.diagrams.untrained import save_untrained

FAKE_BENCH = Path(__file__).parent / "bench_fakes.py"
CELL = [
    "detector", "fault", "severity", "recovery", "n", "tasks", "tpr", "tnr", "balanced_accuracy", "auroc", "auprc",
    "twa", "detection_s", "false_alarms_per_hour", "seconds_lost", "net_benefit", "gap_closed", "disturbed",
]  # fmt: skip
WRITTEN = (
    "summary.json", "bench.parquet", "bench.png", "explorer.html", "explorer/replays.js",
    "networks/mahalanobis.safetensors", "networks/recall_means.safetensors",
)  # fmt: skip


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


@pytest.fixture
def faked(monkeypatch):
    """The tasks that were run."""
    asked = []

    def row(folder, task):
        asked.append(task)
        return bench_fakes.bench_row(folder, task)

    monkeypatch.setattr(bench, "run_bench_task", row)
    return asked


def arguments(weights, out, **changes):
    given = dict(
        detectors=["recall", "mahalanobis"], faults=["A", "payload"], episodes=3, fit_runs=4, calibration_runs=3,
        recoveries=["planned", "hold"], weights=weights, workers=0, out=out,
    )  # fmt: skip
    return BenchArguments(**given | changes)


def summary(out):
    def refused(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads((out / "summary.json").read_text(), parse_constant=refused)


def test_cells_and_rows(weights, tmp_path, faked, capsys):
    assert bench.main(arguments(weights, tmp_path)) == 0
    found = summary(tmp_path)
    assert not {"out", "workers", "scheduler", "tls_ca", "replay"} & set(found["arguments"])
    names = [("never", 0), ("oracle", 1), ("recall", 1), ("mahalanobis", 1)]
    order = [(c["fault"], c["detector"], c["recovery"]) for c in found["cells"]]
    assert sorted(order) == sorted(
        (fault, name, recovery)
        for fault in ("none", "A", "payload") for name, _ in names for recovery in ("planned", "hold")
    )  # fmt: skip
    for cell in found["cells"]:
        assert list(cell) == CELL
        assert cell["n"] == 3
        assert cell["severity"] == (1.0 if cell["fault"] == "payload" else None)
        assert cell["tasks"]["interval"][0] <= cell["tasks"]["value"] <= cell["tasks"]["interval"][1]
    by = {(c["fault"], c["detector"], c["recovery"]): c for c in found["cells"]}
    assert by["A", "recall", "hold"]["detection_s"]["value"] == pytest.approx(0.2)
    assert by["none", "recall", "hold"]["tasks"]["value"] == 1.0
    table = pd.read_parquet(tmp_path / "bench.parquet")
    assert len(table) == 3 * 3 * 4 * 2
    assert set(table["label"]) <= {"needed", "late", "needless", "harmful", "harmful miss", "harmless miss", "quiet"}
    # One run with the detector off for each episode; in the loop what alarmed: all but never, under each fault.
    stages = [task.stage for task in faked]
    counted = {stage: stages.count(stage) for stage in ("fit", "calibration", "off", "loop")}
    assert counted == {"fit": 4, "calibration": 3, "off": 9, "loop": 6 * 3 * 2}
    pooled = {(c["detector"], c["recovery"]): c for c in found["pooled"]}
    assert pooled["recall", "hold"]["n"] == 6
    assert pooled["never", "hold"]["net_benefit"]["value"] == 0.0
    words = capsys.readouterr().out
    assert "tasks done" in words
    assert "retrace" not in words


def test_areas_are_scikit_learns_of_the_stored_scores(weights, tmp_path, faked):
    given = dict(faults=["A", "payload", "friction"], episodes=8, recoveries=["hold"])
    assert bench.main(arguments(weights, tmp_path, **given)) == 0
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()[1:]
    rows = {e["key"]: e["row"] for e in map(json.loads, lines) if e["key"].startswith("off-")}
    compared = 0
    for cell in summary(tmp_path)["cells"] + summary(tmp_path)["pooled"]:
        together = [kind for kind in ("A", "payload", "friction") if cell["fault"] in ("pooled", family_of(kind))]
        kinds = together or [cell["fault"]]
        own = [row for key, row in rows.items() if key.split("-")[3] in {"none", *kinds}]
        shortest, failed = min(row["ticks"] for row in own), [not row["success"] for row in own]
        peaks = [row["detectors"][cell["detector"]]["peaks"] for row in own]
        scores = [max(value for tick, value in run if tick < shortest) for run in peaks]
        if cell["auroc"] is None:
            assert len(set(failed)) == 1
            continue
        assert cell["auroc"]["value"] == pytest.approx(roc_auc_score(failed, scores), abs=1e-12)
        assert cell["auprc"]["value"] == pytest.approx(average_precision_score(failed, scores), abs=1e-12)
        compared += 1
    assert compared >= 12


def test_of_two_severities_it_says_at_which_half_is_noticed(weights, tmp_path, faked):
    given = arguments(weights, tmp_path, faults=["payload"], severities=[0.5, 1.0], recoveries=["hold"])
    assert bench.main(given) == 0
    found = {entry["detector"]: entry["severity"] for entry in summary(tmp_path)["half_noticed"]}
    assert found["recall"]["value"] == 0.5
    assert found["never"] is None


def test_nothing_is_run_twice_and_more_may_be_asked_for(weights, tmp_path, faked):
    assert bench.main(arguments(weights, tmp_path)) == 0
    before = {name: (tmp_path / name).read_bytes() for name in WRITTEN}
    faked.clear()
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert not faked
    assert {name: (tmp_path / name).read_bytes() for name in WRITTEN} == before
    assert bench.main(arguments(weights, tmp_path, recoveries=["planned", "hold", "retrace"])) == 0
    assert {(task.stage, task.recovery) for task in faked} == {("loop", "retrace")}
    faked.clear()
    # A further detector is scored on the runs with the detector off, which are run again for it.
    assert bench.main(arguments(weights, tmp_path, detectors=["recall", "mahalanobis", "speed"])) == 0
    assert {d.label for task in faked if task.stage == "loop" for d in task.detectors} == {"speed"}
    assert {task.stage for task in faked} == {"calibration", "off", "loop"}
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert {name: (tmp_path / name).read_bytes() for name in WRITTEN} == before


def test_what_acts_in_the_loop_may_be_chosen_and_more_later(weights, tmp_path, faked):
    """A diagram is built once: the tasks of each come one after another."""
    assert bench.main(arguments(weights, tmp_path / "all")) == 0
    out = tmp_path / "some"
    faked.clear()
    assert bench.main(arguments(weights, out, loop=["mahalanobis"])) == 0
    loops = [task for task in faked if task.stage == "loop"]
    assert {task.detectors[0].label for task in loops} == {"oracle", "mahalanobis"}
    diagrams = [(task.kind if task.kind == "payload" else "", task.detectors, task.recovery) for task in loops]
    assert len([d for d, before in zip(diagrams, [None, *diagrams], strict=False) if d != before]) == 2 * 2 * 2
    by = {(cell["detector"], cell["fault"]): cell for cell in summary(out)["cells"]}
    assert by["recall", "A"]["tpr"] is not None
    assert by["recall", "A"]["tasks"] is None is by["recall", "A"]["gap_closed"]
    assert by["mahalanobis", "A"]["tasks"] is not None
    table = pd.read_parquet(out / "bench.parquet").set_index("detector")
    assert table.loc["recall", ["success", "lost_s", "label"]].isna().all(axis=None)
    assert table.loc["mahalanobis", ["success", "lost_s", "label"]].notna().all(axis=None)
    faked.clear()
    assert bench.main(arguments(weights, out)) == 0
    assert {(task.stage, task.detectors[0].label) for task in faked} == {("loop", "recall")}
    for name in WRITTEN:
        assert (out / name).read_bytes() == (tmp_path / "all" / name).read_bytes(), name


def start(out, weights, workers):
    command = [sys.executable, FAKE_BENCH, "--out", out, "--weights", weights, "--workers", workers, "--episodes", 3]
    command += ["--detectors", "recall", "mahalanobis", "--faults", "A", "payload", "--recoveries", "planned", "hold"]
    return subprocess.Popen(
        [*map(str, command), "--fit-runs", "4", "--calibration-runs", "3"], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@pytest.mark.parametrize("rows_before", [2, 20])
def test_killed_and_resumed_it_ends_as_one_that_was_left_alone(weights, tmp_path, faked, rows_before):
    assert bench.main(arguments(weights, tmp_path / "whole")) == 0
    out = tmp_path / "killed"
    first, rows = start(out, weights, 2), out / "rows.jsonl"
    deadline = time.monotonic() + 200
    while not rows.exists() or rows.read_bytes().count(b"\n") < rows_before + 1:
        assert time.monotonic() < deadline, first.stderr.read()
        time.sleep(0.01)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = rows.read_bytes().count(b"\n") - 1
    assert rows_before <= done < 52
    faked.clear()
    assert bench.main(arguments(weights, out)) == 0
    assert len(faked) == 52 - done
    for name in WRITTEN:
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_a_lost_tape_or_trace_is_made_again(weights, tmp_path, faked):
    assert bench.main(arguments(weights, tmp_path)) == 0
    lost = [next(tmp_path.glob(name)) for name in ("tapes/*", "explorer/off-*.js", "explorer/loop-*.js")]
    before = [path.read_bytes() for path in lost]
    for path in lost:
        path.unlink()
    faked.clear()
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert [task.stage for task in faked] == ["fit", "off", "loop"]
    assert [path.read_bytes() for path in lost] == before


def test_an_episode_with_an_error_counts_nowhere_and_is_run_again(weights, tmp_path, monkeypatch, capsys):
    def failing(folder, task):
        if task.stage == "loop" and task.seed % 3 == 0 and task.detectors[0].label == "recall":
            return bench_task.error_row(task, RuntimeError("the arm fell off"))
        return bench_fakes.bench_row(folder, task)

    monkeypatch.setattr(bench, "run_bench_task", failing)
    assert bench.main(arguments(weights, tmp_path)) == 1
    assert "the arm fell off" in capsys.readouterr().err
    by = {(c["fault"], c["detector"]): c["n"] for c in summary(tmp_path)["cells"]}
    assert (by["A", "recall"], by["A", "mahalanobis"]) == (2, 3)
    monkeypatch.setattr(bench, "run_bench_task", bench_fakes.bench_row)
    assert bench.main(arguments(weights, tmp_path)) == 0
    assert {c["n"] for c in summary(tmp_path)["cells"]} == {3}


def test_an_episode_under_which_workers_die_is_no_result(weights, tmp_path, monkeypatch):
    def deadly(folder, task):
        died = task.stage == "off" and task.kind == "A" and task.seed % 3 == 0
        return bench_task.error_row(task, WorkerDied("3 in a row")) if died else bench_fakes.bench_row(folder, task)

    monkeypatch.setattr(bench, "run_bench_task", deadly)
    with pytest.raises(InputError, match=r"^1 episodes lost their worker.*: off-\S+-A-\d+: give each worker 1 GB"):
        bench.main(arguments(weights, tmp_path))
    assert (tmp_path / "rows.jsonl").read_text().count('"off-') == 8


def test_an_error_of_an_undisturbed_run_ends_it(weights, tmp_path, monkeypatch):
    failing = lambda folder, task: bench_task.error_row(task, RuntimeError("no light"))  # noqa: E731
    monkeypatch.setattr(bench, "run_bench_task", failing)
    with pytest.raises(InputError, match=r"4 undisturbed runs raised an error .*no light"):
        bench.main(arguments(weights, tmp_path))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"detectors": []}, "--detectors names nothing"),
        ({"detectors": ["telepathy"]}, "there is no detector 'telepathy'"),
        ({"faults": ["earthquake"]}, "there is no disturbance 'earthquake'"),
        ({"severities": [1.5]}, "--severities 1.5 is too large"),
        ({"recoveries": ["panic"]}, "there is no recovery 'panic'"),
        ({"delta": 0.0}, "--delta 0.0 is no share"),
        ({"training_seeds": [7]}, "of training seed 7"),
        ({"fit_runs": 1}, "--fit-runs 1 is too small"),
        ({"loop": []}, "--loop names nothing"),
        ({"loop": ["speed"]}, "--loop speed is none of the detectors here: choose from never, oracle, recall, mahala"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(weights, tmp_path, faked, changes, words):
    with pytest.raises(InputError, match=words):
        bench.main(arguments(weights, tmp_path, **changes))
    assert not faked
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("stage", "place", "value"),
    [("off", "ticks", None), ("off", "onset", 60), ("off", "weights_hash", 5), ("loop", "success", "yes"),
     ("calibration", "detectors", {"speed": {"hash": "", "alarm": None, "false_alarms": 0}}),
     ("off", "detectors", {"speed": {"hash": "", "alarm": None, "false_alarms": 0, "peaks": [[1, 0.5]]}})],
)  # fmt: skip
def test_a_damaged_row_is_refused_by_name_before_anything_runs(weights, tmp_path, faked, stage, place, value):
    assert bench.main(arguments(weights, tmp_path)) == 0
    faked.clear()
    rows = tmp_path / "rows.jsonl"
    lines = [json.loads(line) for line in rows.read_text().splitlines()]
    key = next(line["key"] for line in lines[1:] if line["key"].startswith(stage))
    next(line for line in lines[1:] if line["key"] == key)["row"][place] = value
    rows.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match=f"rows.jsonl is damaged in the row {key}: delete that line"):
        bench.main(arguments(weights, tmp_path, detectors=["recall", "speed"]))
    assert not faked
    assert not (tmp_path / "networks" / "speed.safetensors").exists()


@pytest.mark.parametrize(
    ("ticks", "postures", "words"),
    [(0, 11, "posture is not some ticks"), (5, 10, r"recalled_postures is not 5 ticks of \(11, 8\)")],
)
def test_a_damaged_tape_is_refused_by_name(weights, tmp_path, faked, ticks, postures, words):
    assert bench.main(arguments(weights, tmp_path)) == 0
    tape = next((tmp_path / "tapes").iterdir())
    with np.load(tape) as file:
        arrays = {name: file[name][:ticks] for name in file.files}
    np.savez(tape, **arrays | {"recalled_postures": arrays["recalled_postures"][:, :postures]})
    with pytest.raises(InputError, match=rf"{tape.name} is no whole tape \({words}.*: delete it"):
        bench.main(arguments(weights, tmp_path, detectors=["speed"]))


@pytest.mark.parametrize(
    "name",
    ["summary.json", "bench.parquet", "bench.png", "explorer.html", "networks/lstm.onnx", "tapes/a.npz",
     "explorer/a.js"],
)  # fmt: skip
def test_a_pipe_among_its_files_is_refused(weights, tmp_path, faked, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name} is a pipe or a device, no plain file: choose another --out"):
        bench.main(arguments(weights, tmp_path))
    assert not faked


@pytest.mark.parametrize("means", [[], [0.0], ["x"], None])
def test_damaged_mean_errors_are_refused_by_name(weights, tmp_path, faked, means):
    assert bench.main(arguments(weights, tmp_path)) == 0
    path = tmp_path / "networks" / "mahalanobis.safetensors"
    stored = load_detector(path, "mahalanobis")
    [entry] = stored.metadata.values()
    entry["mean_errors"] = means
    save_detector(path, stored)
    with pytest.raises(InputError, match=r"mahalanobis.safetensors: has the mean errors .*\. Delete it"):
        bench.main(arguments(weights, tmp_path))


def test_a_detector_without_any_error_leaves_no_file(weights, tmp_path, faked, monkeypatch):
    monkeypatch.setattr(bench_fit, "replay", lambda detector, tape, home: np.zeros((len(tape.posture), 1)))
    with pytest.raises(InputError, match="speed: criterion 1 has no error at all"):
        bench.main(arguments(weights, tmp_path, detectors=["speed"]))
    assert {path.suffix for path in (tmp_path / "networks").iterdir()} == {".onnx"}


def test_other_runs_of_the_fit_and_other_weights_do_not_mix(weights, tmp_path, faked):
    assert bench.main(arguments(weights, tmp_path / "out")) == 0
    with pytest.raises(InputError, match=r"another fit_runs \(4, now 5\): choose another --out"):
        bench.main(arguments(weights, tmp_path / "out", fit_runs=5))
    (tmp_path / "weights").mkdir()
    others = save_untrained(tmp_path / "weights", gamma=20.0)
    with pytest.raises(InputError, match=r"made with another lstm.onnx: choose another --out"):
        bench.main(arguments(others, tmp_path / "out"))


def short_runs(monkeypatch, seconds):
    """Real episodes of untrained networks, which do no task: that they did it is made up."""
    monkeypatch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=seconds))

    def taped(job):
        run, record = taped_and_recorded(job)
        return replace(run, outcome=replace(run.outcome, success=job.kind == "none")), record

    monkeypatch.setattr(bench_task, "taped_and_recorded", taped)


def test_real_episodes(weights, tmp_path, monkeypatch):
    """Slippery from the start, which the oracle is told of; what alarms on the tape acts in the loop."""
    short_runs(monkeypatch, 1.0)
    monkeypatch.setattr(bench, "run_bench_task", run_bench_task)
    given = dict(faults=["friction"], detectors=["recall", "mahalanobis"], episodes=2, recoveries=["retrace"])
    assert bench.main(arguments(weights, tmp_path, fit_runs=2, calibration_runs=1, **given)) == 0
    table = pd.read_parquet(tmp_path / "bench.parquet")
    slippery = table[table["fault"] == "friction"].set_index(["detector", "seed"])
    assert (slippery["onset_s"] == 0.0).all()
    assert slippery["needed"].all()
    assert (slippery["ticks"] == 10).all()
    assert slippery.loc["oracle"]["alarm_s"].tolist() == pytest.approx([0.1, 0.1])
    assert slippery.loc["never"]["alarm_s"].isna().all()
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]]
    acted = {entry["key"]: entry["row"] for entry in rows if entry["key"].startswith("loop")}
    assert all(row["error"] is None for row in acted.values())
    assert sum("oracle-retrace" in key for key in acted) == 2
    alarmed = table[table["alarm_s"].notna() | (table["false_alarms"] > 0)]
    assert len(acted) == len(alarmed)
    # The replay of a run is that run, to the bit; of any other none is made.
    key = next(key for key in acted if "oracle-retrace" in key)
    trace, made = (tmp_path / "explorer" / f"{key}{suffix}" for suffix in (".js", ".html"))
    off = next((tmp_path / "explorer").glob("off-*-friction-*.webp"))
    kept, asked = off.read_bytes(), functools.partial(BenchArguments, out=tmp_path)
    assert bench.main(asked(replay=key)) == 0
    assert "<script" in made.read_text()
    assert made.with_suffix(".webp").is_file()
    assert bench.main(asked(replay=off.name.removesuffix(".webp"))) == 0
    assert off.read_bytes() == kept
    assert key in (tmp_path / "explorer" / "replays.js").read_text()
    trace.write_text(trace.read_text().replace('"hash":"', '"hash":"0'))
    with pytest.raises(InputError, match=f"{key} runs otherwise now"):
        bench.main(asked(replay=key))
    trace.unlink()
    for wrong, words in (
        (key, "there is no .*run the command of the bench again"),
        ("off-lstm", "--replay off-lstm: .*no such episode"),
    ):
        with pytest.raises(InputError, match=words):
            bench.main(asked(replay=wrong))
    for option in ({"scheduler": "tcp://127.0.0.1:1"}, {"episodes": 9}):
        with pytest.raises(InputError, match=f"--{next(iter(option))} .* says nothing to --replay.*leave it out"):
            bench.main(asked(replay=key, **option))
    (tmp_path / "summary.json").unlink()
    with pytest.raises(InputError, match=r"summary.json is no summary of a bench .*run the bench in --out"):
        bench.main(asked(replay=key))
