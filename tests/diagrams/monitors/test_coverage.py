"""The promise measured: what is found of runs that keep it, and of drifted ones; a kill; what is refused; real runs."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from diagrams import bench
from diagrams.monitors import coverage_runs
from diagrams.monitors.bench_task import error_row, run_bench_task
from diagrams.monitors.coverage_runs import run_watched
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams import bench_fakes, coverage_fakes
from tests.diagrams.test_bench import arguments, short_runs
from tests.diagrams.untrained import save_untrained

FAKES = Path(coverage_fakes.__file__)
GIVEN = {"runs": 60, "calibration-runs": 40, "disturbed": 4, "resamples": 20, "workers": 0}
DELTAS = ["--deltas", "0.1", "0.2"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A bench of faked runs, with real files of two detectors."""
    folder = tmp_path_factory.mktemp("bench")
    weights = save_untrained(tmp_path_factory.mktemp("weights"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "run_bench_task", bench_fakes.bench_row)
        assert bench.main(arguments(weights, folder, episodes=1, recoveries=["hold"])) == 0
    return folder


@pytest.fixture
def faked(monkeypatch):
    """The tasks that were run."""
    asked = []

    def row(folder, task):
        asked.append(task)
        return coverage_fakes.watched_row(folder, task)

    monkeypatch.setattr(coverage_runs, "run_watched", row)
    return asked


def words(made, out, *more, **changes):
    given = {name: str(value) for name, value in (GIVEN | changes).items()}
    options = [word for name, value in given.items() for word in (f"--{name}", value)]
    return ["coverage", "--bench", str(made), "--out", str(out), *options, *(more or DELTAS)]


def coverage(made, out, *more, **changes):
    return bench.main(bench.parse(words(made, out, *more, **changes)))


def test_runs_that_are_drawn_alike_keep_the_promise(made, tmp_path, faked, capsys):
    assert coverage(made, tmp_path) == 0
    found = json.loads((tmp_path / "coverage.json").read_text())
    assert found["ran"]["fresh"] == {"n": 60, "tasks": 60}
    assert found["ran"]["A"] == {"n": 3, "tasks": 3}  # one never came
    assert [(c["detector"], c["delta"]) for c in found["cells"]] == [
        (name, delta) for name in ("recall", "mahalanobis") for delta in (0.1, 0.2)
    ]
    recall, other = found["cells"][1], found["cells"][3]
    scores = {}
    for line in (tmp_path / "rows.jsonl").read_text().splitlines()[1:]:
        entry = json.loads(line)
        scores[entry["key"]] = entry["row"]["detectors"]["recall"]["score"]
    calibration = sorted(v for key, v in scores.items() if "-none-1" in key)
    fresh = [v for key, v in scores.items() if "-none-2" in key]
    assert (len(calibration), len(fresh)) == (40, 60)
    # floor(41 * 0.2) = 8 of the 40 lie at gamma or above.
    assert recall["constant"]["gamma"] == calibration[-8]
    assert recall["constant"]["false_alarms"] == sum(value > calibration[-8] for value in fresh)
    assert recall["constant"]["promised"] == pytest.approx(8.0 / 41.0)
    assert recall["band"]["promised"] == pytest.approx(4.0 / 21.0)  # a half of the runs gave its gamma
    # With 95 % confidence at most 20 %: of 40 fewer than 8 may lie at gamma or above.
    assert recall["confident"]["gamma"] > recall["constant"]["gamma"]
    assert recall["confident"]["share"] <= 0.2
    assert recall["resampled"]["n"] == 60
    assert len(recall["resampled"]["covered"]) == 20
    for kind in ("A", "B"):
        for name in ("constant", "band"):
            said = recall["disturbed"][kind][name]
            assert said["missed"] == 0
            assert said["bound"] == pytest.approx(1.0 - 0.05 ** (1.0 / 3.0))
            assert 0.0 <= said["detection_s"] <= 0.5
            assert other["disturbed"][kind][name]["n"] == 3
    assert "contradicts" not in capsys.readouterr().out
    assert (tmp_path / "coverage.png").read_bytes().startswith(b"\x89PNG")
    kinds = [task.kind for task in faked]
    assert {kind: kinds.count(kind) for kind in ("none", "A", "B")} == {"none": 100, "A": 4, "B": 4}
    assert {d.label for task in faked for d in task.detectors} == {"recall", "mahalanobis"}


def test_drifted_runs_contradict_it(made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(coverage_runs, "run_watched", coverage_fakes.drifted)
    assert coverage(made, tmp_path) == 1
    assert "contradicts the promise" in capsys.readouterr().out
    for cell in json.loads((tmp_path / "coverage.json").read_text())["cells"]:
        assert cell["contradicted"]
        assert not cell["constant"]["as_expected"]
        assert cell["p_corrected"] >= cell["constant"]["p"]


def test_nothing_is_run_twice_and_more_may_be_asked_for(made, tmp_path, faked):
    assert coverage(made, tmp_path) == 0
    before = (tmp_path / "coverage.json").read_bytes()
    faked.clear()
    assert coverage(made, tmp_path) == 0
    assert not faked
    assert (tmp_path / "coverage.json").read_bytes() == before
    lost = next((tmp_path / "scores").iterdir())
    lost.unlink()
    assert coverage(made, tmp_path) == 0
    assert [task.key for task in faked] == [lost.stem]
    faked.clear()
    assert coverage(made, tmp_path, runs=62) == 0
    assert len(faked) == 2
    assert coverage(made, tmp_path) == 0
    assert (tmp_path / "coverage.json").read_bytes() == before


def test_killed_and_resumed_it_ends_as_one_that_was_left_alone(made, tmp_path, faked):
    assert coverage(made, tmp_path / "whole") == 0
    out = tmp_path / "killed"
    command = [sys.executable, str(FAKES), *words(made, out, workers=2)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(FAKES.parent)))}
    first = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment
    )
    rows, deadline = out / "rows.jsonl", time.monotonic() + 200
    while not rows.exists() or rows.read_bytes().count(b"\n") < 10:
        assert time.monotonic() < deadline, first.stderr.read()
        time.sleep(0.01)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = rows.read_bytes().count(b"\n") - 1
    assert 9 <= done < 108
    faked.clear()
    assert coverage(made, out) == 0
    assert len(faked) == 108 - done
    for name in ("coverage.json", "coverage.png"):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_a_run_that_raised_ends_it_and_is_run_again(made, tmp_path, monkeypatch):
    def failing(folder, task):
        failed = task.kind == "A" and task.seed % 4 == 1
        return error_row(task, RuntimeError("no light")) if failed else coverage_fakes.watched_row(folder, task)

    monkeypatch.setattr(coverage_runs, "run_watched", failing)
    with pytest.raises(InputError, match=r"1 runs raised an error .*no light"):
        coverage(made, tmp_path)
    monkeypatch.setattr(coverage_runs, "run_watched", coverage_fakes.watched_row)
    assert coverage(made, tmp_path) == 0


@pytest.mark.parametrize(
    ("more", "changes", "said"),
    [
        (["--deltas", "1.5"], {}, "--deltas 1.5 is no share"),
        (["--deltas"], {}, "--deltas names nothing"),
        (["--deltas", "0.01", "0.1"], {}, "--calibration-runs 40 are too few for a delta of 0.01: take 198 or more"),
        ([], {"runs": 0}, "--runs 0 is too small"),
        ([], {"seed": 100}, "--seed 100 is too large"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(made, tmp_path, faked, more, changes, said):
    with pytest.raises(InputError, match=said):
        coverage(made, tmp_path / "none", *more, **changes)
    assert not faked
    assert not (tmp_path / "none").exists()


def test_a_bench_without_its_files_is_refused(made, tmp_path, faked):
    with pytest.raises(InputError, match=r"--bench .*is no summary of a bench"):
        coverage(tmp_path, tmp_path / "none")
    (tmp_path / "summary.json").write_text((made / "summary.json").read_text())
    with pytest.raises(InputError, match=r"there is no .*networks/lstm.onnx: run the bench again"):
        coverage(tmp_path, tmp_path / "none")
    (tmp_path / "networks").mkdir()
    for path in (made / "networks").iterdir():
        if path.stem != "mahalanobis":
            (tmp_path / "networks" / path.name).write_bytes(path.read_bytes())
    with pytest.raises(InputError, match=r"mahalanobis.safetensors has nothing for lstm.onnx: run the bench again"):
        coverage(tmp_path, tmp_path / "none")
    assert not faked


def test_damaged_files_are_refused_by_name(made, tmp_path, faked):
    assert coverage(made, tmp_path) == 0
    scores = next((tmp_path / "scores").glob("*none*"))
    with np.load(scores) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(scores, **arrays | {"ratios": arrays["ratios"][1:]})
    with pytest.raises(InputError, match=rf"{scores.name} is damaged \(59 ticks, not 60\): delete it"):
        coverage(made, tmp_path)
    rows = tmp_path / "rows.jsonl"
    rows.write_text(rows.read_text().replace('"end": 40', '"end": 61'))
    with pytest.raises(InputError, match=r"rows.jsonl is damaged in the row calibration-lstm-0-A-\d+: delete"):
        coverage(made, tmp_path)


def test_real_runs_have_the_scores_of_the_bench(tmp_path, monkeypatch):
    """The calibration runs are the bench's own: their scores are those that its gamma comes from."""
    weights = save_untrained(tmp_path)
    short_runs(monkeypatch, 1.2)
    monkeypatch.setattr(bench, "run_bench_task", run_bench_task)
    monkeypatch.setattr(coverage_runs, "run_watched", run_watched)
    given = dict(detectors=["recall", "speed"], faults=["friction"], episodes=1, recoveries=["hold"])
    assert bench.main(arguments(weights, tmp_path / "bench", fit_runs=2, calibration_runs=2, **given)) == 0
    changes = {"runs": 2, "calibration-runs": 2, "disturbed": 0}
    assert coverage(tmp_path / "bench", tmp_path / "out", "--deltas", "0.5", **changes) in (0, 1)

    def rows(folder):
        return {e["key"]: e["row"] for e in map(json.loads, (folder / "rows.jsonl").read_text().splitlines()[1:])}

    benched, own = rows(tmp_path / "bench"), rows(tmp_path / "out")
    same = own.keys() & benched.keys()
    assert len(same) == 2
    for key in same:
        for label, said in own[key]["detectors"].items():
            assert said["score"] == benched[key]["detectors"][label]["peaks"][-1][1]
        with np.load(tmp_path / "out" / "scores" / f"{key}.npz") as file:
            assert file["ratios"].max(axis=0) == pytest.approx(
                [own[key]["detectors"][label]["score"] for label in file["labels"].tolist()], rel=1e-6
            )
            assert file["posture"].shape == (own[key]["ticks"], 8)
