"""Demonstrations as a LeRobotDataset: what the files hold, that they are completed, and lerobot's own loader."""

import importlib.util
import json

import av
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from models.data.lerobot import CAMERA, LeRobotFolder
from models.errors import InputError
from tests.diagrams import teacher_fakes

LENGTHS = (40, 25, 31)
SETTINGS = {"seed": 0, "world": {"opening": 0.08}}
NAMES = [*(f"joint_{j}" for j in range(1, 8)), "opening"]
WORLD = {"models": "iiwa.dmd.yaml"}
ATTRIBUTES = {
    "period": 0.1, "posture_names": json.dumps(NAMES), "initial_posture": np.zeros(8), "world": json.dumps(WORLD)
}  # fmt: skip


def recording(index, **changes):
    """Pictures as smooth as a camera's, which a codec leaves nearly as they are; each tick another shade."""
    ticks = LENGTHS[index]
    ramp = np.linspace(0, 120, 112)
    rgb = np.empty((ticks, 112, 112, 3))
    for channel, part in enumerate((ramp[:, None], ramp[None], ramp[:, None] + ramp[None])):
        rgb[..., channel] = part + 3 * np.arange(ticks)[:, None, None] + 10 * index
    given = {"rgb": np.clip(rgb, 0, 255).astype(np.uint8), "vacant": ("left", "right", "left")[index]}
    return teacher_fakes.recording(index, ticks, **(given | changes))


def write(path, indices=(0, 1, 2), listed=(0, 1, 2), **changes):
    with LeRobotFolder(path, SETTINGS, ATTRIBUTES) as folder:
        for index in indices:
            if f"demo_{index}" not in folder:
                folder.add(recording(index, **changes))
        return folder.finish([f"demo_{index}" for index in listed])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three demonstrations, written in another order."""
    path = tmp_path_factory.mktemp("lerobot") / "data"
    assert write(path, (2, 0, 1))[1] == []
    return path


def rows(folder):
    return pd.concat([pd.read_parquet(path) for path in sorted(folder.glob("data/*/*.parquet"))], ignore_index=True)


def test_numbers_are_the_recordings(folder):
    found, first = rows(folder), 0
    assert found["index"].tolist() == list(range(sum(LENGTHS)))
    for index, length in enumerate(LENGTHS):
        part, given = found[first : first + length], recording(index)
        assert np.array_equal(np.stack(part["observation.state"]), given.posture.astype(np.float32))
        assert np.array_equal(np.stack(part["action"]), given.actions.astype(np.float32))
        assert part["episode_index"].unique().tolist() == [index]
        assert part["frame_index"].tolist() == list(range(length))
        assert np.array_equal(part["timestamp"], (0.1 * np.arange(length)).astype(np.float32))
        first += length


def test_videos_show_the_pictures(folder):
    for index, length in enumerate(LENGTHS):
        with av.open(str(folder / "videos" / CAMERA / f"chunk-000/file-{index:03d}.mp4")) as container:
            frames = list(container.decode(video=0))
        assert [float(frame.time) for frame in frames] == pytest.approx(0.1 * np.arange(length))
        shown = np.array([frame.to_ndarray(format="rgb24") for frame in frames])
        assert np.abs(shown.astype(float) - recording(index).rgb).mean() < 2.0  # a tick is 3 further


def test_meta_says_where_everything_is(folder):
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 10, 3)
    assert (info["total_frames"], info["splits"]) == (sum(LENGTHS), {"train": "0:3"})
    assert info["features"][CAMERA]["shape"] == [112, 112, 3]
    assert info["features"]["action"]["names"] == NAMES
    assert info["features"].keys() - {CAMERA} == set(rows(folder).columns)
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for index, episode in enumerate(episodes):
        given, start = recording(index), sum(LENGTHS[:index])
        ends = episode["dataset_from_index"], episode["dataset_to_index"]
        assert (episode["length"], *ends) == (LENGTHS[index], start, start + LENGTHS[index])
        video, data = f"videos/{CAMERA}", episode["data/file_index"]
        name = info["video_path"].format(video_key=CAMERA, chunk_index=0, file_index=episode[f"{video}/file_index"])
        assert (folder / name).is_file()
        assert (folder / info["data_path"].format(chunk_index=0, file_index=data)).is_file()
        assert episode[f"{video}/to_timestamp"] == pytest.approx(0.1 * LENGTHS[index])
        assert (episode["split"], episode["success"], episode["vacant"]) == (given.split, True, given.vacant)
        assert episode["can_xy"] == given.can_xy.tolist()
        tasks = pd.read_parquet(folder / "meta" / "tasks.parquet")
        assert given.vacant in episode["tasks"][0]
        of_episode = rows(folder)["episode_index"] == index
        assert set(rows(folder)[of_episode]["task_index"]) == {tasks.loc[episode["tasks"][0], "task_index"]}


def test_statistics(folder):
    stats = json.loads((folder / "meta" / "stats.json").read_text())
    whole = np.concatenate([recording(index).actions for index in range(3)])
    np.testing.assert_allclose(stats["action"]["mean"], whole.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats["action"]["std"], whole.std(axis=0), atol=1e-6)
    np.testing.assert_allclose(stats["action"]["q90"], np.quantile(whole, 0.9, axis=0), atol=1e-6)
    pictures = np.concatenate([recording(index).rgb for index in range(3)]).reshape(-1, 3) / 255.0
    for name, value in (("mean", pictures.mean(0)), ("std", pictures.std(0)), ("min", pictures.min(0))):
        assert np.shape(stats[CAMERA][name]) == (3, 1, 1)
        np.testing.assert_allclose(np.ravel(stats[CAMERA][name]), value, atol=1e-12)
    assert np.ravel(stats[CAMERA]["q50"]) == pytest.approx(np.quantile(pictures, 0.5, axis=0), abs=1 / 255)
    assert stats[CAMERA]["count"] == stats["action"]["count"] == [sum(LENGTHS)]


def test_what_is_missing_is_added(folder, tmp_path):
    whole = write(folder, ())[0]
    path = tmp_path / "parts"
    assert write(path, (1,), (1,))[0] != whole
    write(path, (2,), (1, 2))
    (path / f"videos/{CAMERA}/chunk-000/file-002.mp4").unlink()
    assert write(path)[0] == whole
    for file in (path for path in folder.rglob("*") if path.is_file()):
        assert (path / file.relative_to(folder)).read_bytes() == file.read_bytes(), file


def test_demonstrations_beyond_those_that_are_asked_for_are_refused(tmp_path):
    write(tmp_path)
    with pytest.raises(InputError, match="has 1 demonstrations beyond the 2 that are asked for"):
        write(tmp_path, (), (0, 1))


def test_what_a_killed_run_left_is_deleted(tmp_path):
    write(tmp_path, (0,), (0,))
    left = [tmp_path / f"videos/{CAMERA}/chunk-000" / name for name in ("part-file-001.mp4", "file-001.mp4")]
    left += [tmp_path / "data/chunk-000/file-001.parquet.part"]
    for path in left:
        path.touch()
    write(tmp_path, (), (0,))
    assert not any(path.exists() for path in left)
    assert json.loads((tmp_path / "meta/info.json").read_text())["robot_type"] == "iiwa"


def test_failures_are_named_and_count(folder, tmp_path):
    content, failed = write(tmp_path / "failed", success=False)
    assert failed == ["demo_0", "demo_1", "demo_2"]
    assert content != write(folder, ())[0]


def test_bad_input_is_named(folder, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    for path in (tmp_path / "mine", tmp_path / "mine" / "file"):
        with pytest.raises(InputError, match="no data set of"):
            write(path)
    with pytest.raises(InputError, match="cannot be written"):
        write("/dev/null" / tmp_path.relative_to("/"))
    with pytest.raises(InputError, match="recorded with another seed"):
        LeRobotFolder(folder, SETTINGS | {"seed": 1}, ATTRIBUTES)
    with pytest.raises(InputError, match=r"period of 0\.15 s"):
        LeRobotFolder(tmp_path / "new", SETTINGS, ATTRIBUTES | {"period": 0.15})
    write(tmp_path / "damaged", (0,), (0,))
    (tmp_path / "damaged/data/chunk-000/file-000.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"file-000\.parquet is damaged"):
        write(tmp_path / "damaged", (), (0,))


@pytest.mark.skipif(not importlib.util.find_spec("lerobot"), reason="the package lerobot is not installed")
def test_lerobots_own_loader_reads_it(folder):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("hindsight/pick_place", root=folder)
    assert (len(dataset), dataset.num_episodes, dataset.fps) == (sum(LENGTHS), 3, 10)
    for index, tick in ((0, 0), (1, 24), (2, 7)):
        item, given = dataset[sum(LENGTHS[:index]) + tick], recording(index)
        assert np.array_equal(item["observation.state"], given.posture[tick].astype(np.float32))
        assert np.array_equal(item["action"], given.actions[tick].astype(np.float32))
        assert (int(item["episode_index"]), given.vacant in item["task"]) == (index, True)
        picture = 255.0 * item[CAMERA].numpy().transpose(1, 2, 0)
        assert np.abs(picture - given.rgb[tick]).mean() < 2.0
    assert np.shape(dataset.meta.stats[CAMERA]["mean"]) == (3, 1, 1)
