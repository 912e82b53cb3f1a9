"""Detectors on recorded runs of other arms: what is noticed, what is left out, and the same scores as in the bench."""

import importlib.util
import json

import h5py
import numpy as np
import pytest

from diagrams import bench
from diagrams.monitors.offline import RESULT, Arm
from models.data.motions import Motion, read_motions
from models.data.runs import of_policy
from models.errors import InputError
from models.files.detectors import load_detector
from systems.detectors import DETECTORS
from tests.diagrams.monitors.test_export import export, made  # noqa: F401 (a fixture)

DONE = 48  # runs that did their task
CHEAP = ["knn", "subspace", "reversals", "speed", "pca_kmeans", "pyod:ECOD"]


def motion(rng, joints, failed, ticks=60):
    """Swings of each joint; where it fails, it shakes from the 30th tick on."""
    phase = np.linspace(0.0, 3.0, ticks)[:, None] + 0.2 * np.arange(joints) + rng.normal(0.0, 0.05, joints)
    states = np.sin(phase) + rng.normal(0.0, 0.03, (ticks, joints))
    if failed:
        states[30:] += rng.normal(0.0, 0.5, (ticks - 30, joints))
    return states, np.vstack((states[1:], states[-1:]))


def save(path, joints, scale=1.0, failures=6, said=True, period=0.05):
    """A robomimic file of DONE runs that did their task, and of others that failed."""
    rng = np.random.default_rng(joints)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 1.0 / period} if period else {}})
        for i in range(DONE + failures):
            states, actions = motion(rng, joints, i >= DONE, 60 + i)
            group = data.create_group(f"demo_{i}")
            group["actions"], group["obs/robot0_joint_pos"] = scale * actions, scale * states[:, :4]
            group["obs/rest"] = scale * states[:, 4:]
            if said:
                group["rewards"] = np.append(np.zeros(len(states) - 1), i < DONE)
    return path


def offline(*words):
    return bench.main(bench.parse(["offline", *map(str, words)]))


@pytest.mark.parametrize(("joints", "scale"), [(7, 1.0), (6, 57.3)])
def test_it_notices_failures_of_any_arm(tmp_path, joints, scale, capsys):
    file = save(tmp_path / "theirs.hdf5", joints, scale)
    given = ["--data", file, "--state", "robot0_joint_pos", "rest", "--out", tmp_path]
    assert offline(*given, "--detectors", *CHEAP) == 0
    found = json.loads((tmp_path / RESULT).read_text())
    assert found["runs"] == {"fit": 19, "means": 5, "calibration": 12, "judged": 18, "failed": 6}
    assert found["period"] == pytest.approx(0.05)
    by = {entry["detector"]: entry for entry in found["detectors"]}
    assert list(by) == ["knn", "subspace", "reversals", "speed", "pca_kmeans", "pyod-ECOD"]
    for name in ("knn", "subspace", "reversals", "speed", "pca_kmeans"):
        assert by[name]["tpr"]["value"] == by[name]["auroc"]["value"] == 1.0, name
        assert by[name]["tnr"]["value"] >= 0.5, name
    runs = by["speed"]["of_runs"].values()
    assert sum(not run["success"] for run in runs) == 6
    assert all(1.45 <= run["alarm_s"] < 2.5 for run in runs if not run["success"])
    early = np.mean(
        [1.0 - run["alarm_s"] / (3.0 + 0.05 * i) for i, run in enumerate(runs, DONE - 12) if not run["success"]]
    )
    assert by["speed"]["twa"]["value"] == pytest.approx(0.5 * (early + by["speed"]["tnr"]["value"]), abs=0.02)
    words = capsys.readouterr().out
    assert "balanced_accuracy" in words
    assert "left out" not in words


def test_none_named_are_all_that_can_be(tmp_path, monkeypatch, capsys):
    file = save(tmp_path / "theirs.hdf5", 6)
    ours = DETECTORS._entries
    kept = ("recall", "innovation", "mahalanobis", "ensemble", "never", "oracle", "reversals", "pca_kmeans")
    monkeypatch.setattr(DETECTORS, "_entries", {name: ours[name] for name in kept})
    assert offline("--data", file, "--state", "robot0_joint_pos", "--out", tmp_path, "--joints", 4) == 0
    found = json.loads((tmp_path / RESULT).read_text())
    assert [entry["detector"] for entry in found["detectors"]] == ["reversals", "pca_kmeans"]
    assert list(found["left_out"]) == list(kept[:6])
    assert "left out, it needs the network's hidden state" in capsys.readouterr().out


def test_a_joint_that_never_moves_is_named(tmp_path, capsys):
    file = save(tmp_path / "theirs.hdf5", 6)
    with h5py.File(file, "r+") as opened:
        for group in opened["data"].values():
            group["obs/rest"][...] = 0.0
    given = ["--data", file, "--state", "robot0_joint_pos", "rest", "--out", tmp_path]
    with pytest.raises(InputError, match=r"subspace: criterion 5 has no error at all .*: leave it out"):
        offline(*given, "--detectors", "subspace")
    assert offline(*given, "--detectors", "subspace", "knn", "--joints", 4) == 0
    assert "tpr" in capsys.readouterr().out


def test_where_nobody_says_what_came_of_the_runs_there_are_only_alarms(tmp_path):
    file = save(tmp_path / "theirs.hdf5", 6, failures=0, said=False)
    assert offline("--data", file, "--state", "rest", "--out", tmp_path, "--detectors", "speed") == 0
    [speed] = json.loads((tmp_path / RESULT).read_text())["detectors"]
    assert (speed["tpr"], speed["auroc"]) == (None, None)
    assert speed["tnr"]["value"] >= 0.5


def test_of_our_own_export_the_scores_are_those_of_the_bench(made):  # noqa: F811
    for path in ("data/robomimic.hdf5", "data/lerobot"):
        motions = read_motions(made / path)
        assert [motion.period for motion in motions] == [0.1, 0.1]
        assert [motion.success for motion in motions] == [False, False]  # of an untrained network
        arm, exact = Arm.of(motions, 0.1), path.endswith("hdf5")
        with h5py.File(made / "data/robomimic.hdf5") as file:
            labels = json.loads(file["data"].attrs["names"])["scores"]
            scores = [group["obs/scores"][()] for group in file["data"].values()]
        for label in ("speed", "knn"):
            stored = load_detector(made / f"networks/{label}.safetensors", label)
            [(policy_hash, entry)] = stored.metadata.items()
            detector = DETECTORS[label].build(arm, 7, of_policy(policy_hash, stored.arrays))
            for run, given in zip(motions, scores, strict=True):
                found = (arm.errors(detector, run) / entry["mean_errors"]).max(axis=1)
                close = dict(rtol=1e-6, atol=1e-9) if exact else dict(rtol=1e-2, atol=1e-3)  # LeRobot's are float32
                np.testing.assert_allclose(found, given[:, labels.index(label)], **close)
                assert found.max() > 0.1


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([], "has no observation posture: choose from rest, robot0_joint_pos by --state"),
        (["--state", "rest", "--detectors", "recall"], "recall: it needs the network's hidden state.*leave it out"),
        (["--state", "rest", "--joints", "3"], "--joints 3 is more than the 2 components"),
        (["--state", "rest", "--delta", "0"], "--delta 0.0 is no share"),
        (["--state", "rest", "--detectors", "telepathy"], "there is no detector 'telepathy'"),
    ],
)
def test_bad_input_is_named(tmp_path, more, words):
    file = save(tmp_path / "theirs.hdf5", 6)
    with pytest.raises(InputError, match=words):
        offline("--data", file, "--out", tmp_path / "out", *more)
    assert not [*tmp_path.glob("out/*")]


def test_bad_data_are_named(tmp_path):
    given = ["--state", "rest", "--out", tmp_path / "out"]
    for path, words in (
        (tmp_path / "none.hdf5", "there is no file"),
        (tmp_path, "is no LeRobotDataset, or a damaged one"),
        (save(tmp_path / "timeless.hdf5", 6, period=None), "give --period"),
    ):
        with pytest.raises(InputError, match=words):
            offline("--data", path, *given)
    with pytest.raises(InputError, match="--data names no file: give one or more"):
        offline("--data", *given)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="is no LeRobotDataset, or a damaged one"):
        offline("--data", tmp_path, *given)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/offline\.json cannot be written .*: choose another name"):
        offline(
            "--data", save(tmp_path / "six.hdf5", 6), *given[:2], "--detectors", "speed", "--out", tmp_path / "file"
        )
    few, other = tmp_path / "few.hdf5", save(tmp_path / "seven.hdf5", 7)
    with h5py.File(save(few, 6), "r+") as file:
        for i in range(7, DONE):
            del file[f"data/demo_{i}"]
    with pytest.raises(InputError, match="7 of the runs did their task, 8 or more are needed: add some"):
        offline("--data", few, *given)
    with pytest.raises(
        InputError,
        match=r"seven.hdf5/demo_0 has states and actions of \(3, 7\) components, others .*: give runs of one arm",
    ):
        offline("--data", few, other, *given)
    with pytest.raises(InputError, match=r"2 runs of --data are called seven\.hdf5/demo_0: give each once"):
        offline("--data", other, other, *given)
    with h5py.File(few, "r+") as file:
        file["data/demo_0/obs/rest"][3] = np.nan
    with pytest.raises(InputError, match=r"few\.hdf5/demo_0 has states .* no finite rows"):
        offline("--data", few, *given)
    assert isinstance(read_motions(other, ["rest"])[0], Motion)


@pytest.mark.skipif(not importlib.util.find_spec("lerobot"), reason="the package lerobot is not installed")
def test_it_judges_what_lerobots_own_writer_wrote(tmp_path):
    """Several episodes a file, files in several folders, two tasks, videos, a success in the last frame."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    names, rng, runs = [f"joint_{i}.pos" for i in range(6)], np.random.default_rng(6), []
    features = {
        **{key: {"dtype": "float32", "shape": (6,), "names": names} for key in ("observation.state", "action")},
        "observation.images.top": {"dtype": "video", "shape": (64, 96, 3), "names": ["height", "width", "channels"]},
        "next.success": {"dtype": "bool", "shape": (1,), "names": None},
    }
    folder = tmp_path / "theirs"
    written = LeRobotDataset.create("they/theirs", fps=20, features=features, root=folder, robot_type="so101_follower")
    written.meta.update_chunk_settings(chunks_size=2, data_files_size_in_mb=0.02, video_files_size_in_mb=0.1)
    for i in range(30):
        failed = i >= 24
        states, actions = motion(rng, 6, failed, 60 + i)
        runs.append((states.astype(np.float32), actions.astype(np.float32), not failed))
        for tick, (state, action) in enumerate(zip(*runs[-1][:2], strict=True)):
            done = np.array([tick == len(states) - 1 and not failed])
            frame = {"observation.state": state, "action": action, "next.success": done}
            picture = np.full((64, 96, 3), tick, np.uint8)
            written.add_frame(frame | {"observation.images.top": picture, "task": ("pick", "place")[i % 2]})
        written.save_episode()
    written.finalize()
    files = [*(folder / "data").rglob("*.parquet")]
    assert 3 < len(files) < 30
    assert len({file.parent for file in files}) > 1
    found = read_motions(folder)
    assert [motion.name for motion in found] == [f"theirs/episode_{i}" for i in range(30)]
    for read, (states, actions, done) in zip(found, runs, strict=True):
        assert np.array_equal(read.states, states)
        assert np.array_equal(read.actions, actions)
        assert (read.success, read.period) == (done, 0.05)
    assert offline("--data", folder, "--detectors", "speed", "knn", "--out", tmp_path) == 0
    for entry in json.loads((tmp_path / RESULT).read_text())["detectors"]:
        assert entry["failed"] == 6
        assert entry["tpr"]["value"] == entry["auroc"]["value"] == 1.0
