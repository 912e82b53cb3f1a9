"""The runs of a bench as data sets: what they hold is what the bench has seen; killed ones are completed."""

import importlib.util
import json
import os

import h5py
import numpy as np
import pandas as pd
import pytest

from diagrams import bench
from diagrams.monitors.bench_task import job_of, run_bench_task
from diagrams.monitors.export import DIGESTS, LEROBOT, ROBOMIMIC, _table
from diagrams.monitors.replays import tasks_of
from diagrams.monitors.tapes import run_taped
from diagrams.world.configuration import World
from models.data.lerobot import CAMERA
from models.data.recording import RecordingFile
from models.errors import InputError
from tests.diagrams.test_bench import arguments, short_runs
from tests.diagrams.untrained import save_untrained


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A bench of one second's runs of an untrained network, and two of its runs as data sets."""
    folder = tmp_path_factory.mktemp("bench")
    weights = save_untrained(tmp_path_factory.mktemp("weights"))
    given = dict(faults=["friction"], detectors=["recall", "speed", "knn"], episodes=1, recoveries=["hold"])
    with pytest.MonkeyPatch.context() as patch:
        short_runs(patch, 1.2)
        patch.setattr(bench, "run_bench_task", run_bench_task)
        assert bench.main(arguments(weights, folder, fit_runs=2, calibration_runs=1, **given)) == 0
        assert export(folder, folder / "data") == 0
        yield folder


def export(folder, out, *more):
    return bench.main(bench.parse(["export", "--bench", str(folder), "--out", str(out), "--workers", "0", *more]))


def test_hdf5_holds_the_runs_of_the_bench(made):
    rows = {e["key"]: e["row"] for e in map(json.loads, (made / "rows.jsonl").read_text().splitlines()[1:])}
    table = pd.read_parquet(made / "bench.parquet")
    with h5py.File(made / "data" / ROBOMIMIC) as file:
        labels = json.loads(file["data"].attrs["names"])["scores"]
        assert sorted(file["data"]) == [name.decode() for name in file["mask/train"]] == ["demo_0", "demo_1"]
        for group in file["data"].values():
            notes, obs = dict(group.attrs), {name: array[()] for name, array in group["obs"].items()}
            row = rows[notes["key"]]
            assert len(obs["rgb"]) == row["ticks"] == len(group["actions"])
            for label, scores in zip(labels, obs["scores"].T, strict=True):
                assert scores.max() == row["detectors"][label]["peaks"][-1][1]
            assert not obs["mode"].any()
            assert notes["onset"] == (-1 if row["onset"] is None else row["onset"])
            assert obs["fault_active"].any() == (notes["fault"] != "none")
            own = table[table["fault"] == notes["fault"]].set_index("detector")
            assert json.loads(notes["outcomes"]) == {
                "never": not own["needed"].iloc[0],
                **{f"{name}-hold": bool(own.loc[name, "success"]) for name in labels if name != "never"},
            }
        disturbed = file["data/demo_1"]
        assert disturbed.attrs["fault"] == "friction"
        task = next(task for task in tasks_of(made, "") if task.key == disturbed.attrs["key"])
        tape = run_taped(job_of(made / "networks", task)).tape
        for name in ("hidden_state", "features", "predicted_features"):
            assert np.array_equal(disturbed[f"obs/{name}"], getattr(tape, name)), name
        assert np.ptp(disturbed["obs/features"][()], axis=0).any()
        first = disturbed["obs/recalled_postures"][0].reshape(11, 8)
        assert first == pytest.approx(np.tile(World().initial_posture, (11, 1)))


def test_what_was_scored_alone_has_no_outcome(tmp_path):
    alone = dict(fault="A", severity=None, rnn="lstm", training_seed=0, seed=1, needed=True, recovery="hold")
    rows = [dict(detector="never", success=False, alarm_s=None, false_alarms=0),
            dict(detector="oracle", success=True, alarm_s=1.0, false_alarms=0),
            dict(detector="recall", success=None, alarm_s=1.0, false_alarms=0)]  # fmt: skip
    pd.DataFrame([alone | row for row in rows]).to_parquet(tmp_path / "bench.parquet")
    episode = "A", None, "lstm", 0, 1
    assert _table(tmp_path) == ({episode: {"never": False, "oracle-hold": True}}, {(*episode, "oracle")})


def test_both_data_sets_have_the_same_numbers(made):
    with h5py.File(made / "data" / ROBOMIMIC) as file:
        for number, group in enumerate(file["data"].values()):
            rows = pd.read_parquet(made / "data" / LEROBOT / f"data/chunk-000/file-{number:03d}.parquet")
            given = {f"observation.{name}": array[()] for name, array in group["obs"].items() if name != "rgb"}
            given["observation.state"], given["action"] = given.pop("observation.posture"), group["actions"][()]
            for name, array in given.items():
                assert np.array_equal(np.stack(rows[name]).reshape(array.shape), array.astype(np.float32)), name
    info = json.loads((made / "data" / LEROBOT / "meta/info.json").read_text())
    assert info["features"]["observation.scores"]["names"] == ["never", "oracle", "recall", "speed", "knn"]
    assert info["features"]["observation.mode"]["shape"] == [1]


def test_in_the_loop_the_detector_acts(made, tmp_path):
    assert export(made, tmp_path, "--stage", "loop", "--faults", "friction") == 0
    with h5py.File(tmp_path / ROBOMIMIC) as file:
        found = {group.attrs["detector"]: group for group in file["data"].values()}
        assert found["oracle"]["obs/mode"][()].any()
        assert found["oracle"].attrs["recovery"] == "hold"
        assert np.array_equal(found["oracle"]["obs/mode"][()] > 0.5, found["oracle"]["obs/alpha"][()] >= 0.5)
        assert not found["oracle"].attrs["never_success"]


def test_made_again_the_digests_are_equal(made, tmp_path, capsys):
    assert export(made, made / "data", "--check", "0.01") == 0
    assert "1 of 1 runs made again have the same digest" in capsys.readouterr().out
    digests = json.loads((made / "data" / DIGESTS).read_text())
    (tmp_path / DIGESTS).write_text(json.dumps(dict.fromkeys(digests, "0")))
    assert export(made, tmp_path, "--check", "1") == 1
    assert "0 of 2 runs" in capsys.readouterr().out


def test_what_is_missing_is_added(made, tmp_path, monkeypatch):
    add, left = RecordingFile.add, [1]

    def full(self, run):
        if not left:
            raise OSError(28, "No space left on device")
        left.pop()
        add(self, run)

    monkeypatch.setattr(RecordingFile, "add", full)
    with pytest.raises(OSError, match="No space"):
        export(made, tmp_path)
    monkeypatch.setattr(RecordingFile, "add", add)
    assert len(json.loads((tmp_path / DIGESTS).read_text())) == 1
    assert export(made, tmp_path) == 0
    for name in (DIGESTS, f"{LEROBOT}/meta/stats.json", f"{LEROBOT}/videos/{CAMERA}/chunk-000/file-001.mp4"):
        assert (tmp_path / name).read_bytes() == (made / "data" / name).read_bytes(), name


def test_bad_input_is_named(made, tmp_path):
    for more, words in (
        (["--faults", "payload"], "has no such run: ask for other --faults"),
        (["--limit", "0"], "--limit 0 is too small"),
        (["--check", "0.5"], "with which --check compares: export to this --out first"),
    ):
        with pytest.raises(InputError, match=words):
            export(made, tmp_path / "none", *more)
    for text in ("", "[" * 200_000):
        (tmp_path / "summary.json").write_text(text)
        with pytest.raises(InputError, match=r"--bench .*is no summary of a bench"):
            export(tmp_path, tmp_path / "none")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / DIGESTS).write_text("[" * 200_000)
    for check in (["--check", "1"], []):  # before a part of it is begun
        with pytest.raises(InputError, match=r"has no digests .*: delete it"):
            export(made, tmp_path / "deep", *check)
    assert [each.name for each in (tmp_path / "deep").iterdir()] == [DIGESTS]
    assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match="was recorded with another episodes"):
        export(made, made / "data", "--limit", "1")
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / ROBOMIMIC)
    with pytest.raises(InputError, match=r"robomimic\.hdf5 is a pipe"):
        export(made, tmp_path / "pipe")
    assert len([*(tmp_path / "pipe").iterdir()]) == 1
    trace = next((made / "explorer").glob("off-*friction*.js"))
    whole = trace.read_text()
    for content in (whole.replace('"hash":"', '"hash":"0').encode(), b"\xff"):
        trace.write_bytes(content)
        with pytest.raises(InputError, match="runs otherwise now than in"):
            export(made, tmp_path / "others")
    trace.write_text(whole)


@pytest.mark.skipif(not importlib.util.find_spec("lerobot"), reason="the package lerobot is not installed")
def test_lerobots_own_loader_reads_it(made):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("hindsight/bench", root=made / "data" / LEROBOT)
    with h5py.File(made / "data" / ROBOMIMIC) as file:
        groups = [file["data/demo_0"], file["data/demo_1"]]
        assert (dataset.num_episodes, len(dataset)) == (2, sum(len(group["actions"]) for group in groups))
        for number, tick in ((0, 0), (0, 7), (1, 9)):
            item, group = dataset[number * len(groups[0]["actions"]) + tick], groups[number]
            assert np.array_equal(item["action"], group["actions"][tick].astype(np.float32))
            for name in ("hidden_state", "recalled_postures", "scores", "mode", "alpha", "fault_active"):
                given = group[f"obs/{name}"][tick].astype(np.float32)
                assert np.array_equal(np.ravel(item[f"observation.{name}"]), given), name
            picture = 255.0 * item[CAMERA].numpy().transpose(1, 2, 0)
            assert np.abs(picture - group["obs/rgb"][tick]).mean() < 4.0
