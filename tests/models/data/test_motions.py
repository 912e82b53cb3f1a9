"""Runs of other arms: of LeRobot's folders as others write them, and of robomimic's files."""

import json

import h5py
import numpy as np
import pandas as pd
import pytest

from models.data.motions import read_motions
from models.errors import InputError


def lerobot(path, version="v3.0", **columns):
    """Two episodes in one file, as LeRobot itself writes them; the second one is done in its last frame."""
    (path / "meta").mkdir(parents=True)
    (path / "data/chunk-000").mkdir(parents=True)
    frames = {
        "observation.state": list(np.arange(14.0).reshape(7, 2)), "action": list(np.arange(21.0).reshape(7, 3)),
        "gripper": np.arange(7.0), "episode_index": [0, 0, 0, 1, 1, 1, 1], "next.success": [False] * 6 + [True],
    } | columns  # fmt: skip
    pd.DataFrame(frames).to_parquet(path / "data/chunk-000/file-000.parquet")
    features = {name: {} for name in frames}
    info = {"codebase_version": version, "fps": 50, "features": features}
    (path / "meta/info.json").write_text(json.dumps(info))
    return path


def test_episodes_of_one_file_are_told_apart(tmp_path):
    first, second = read_motions(lerobot(tmp_path / "theirs"))
    assert (first.name, second.name) == ("theirs/episode_0", "theirs/episode_1")
    assert first.states.tolist() == [[0, 1], [2, 3], [4, 5]]
    assert second.actions.tolist() == [[9, 10, 11], [12, 13, 14], [15, 16, 17], [18, 19, 20]]
    assert (first.success, second.success, first.period) == (False, True, 0.02)


def test_observations_are_put_side_by_side(tmp_path):
    _, second = read_motions(lerobot(tmp_path / "theirs"), ["observation.state", "gripper"])
    assert second.states.tolist() == [[6, 7, 3], [8, 9, 4], [10, 11, 5], [12, 13, 6]]
    with h5py.File(tmp_path / "theirs.hdf5", "w") as file:
        for i in (10, 9):
            group = file.create_group(f"data/demo_{i}")
            group["actions"], group["obs/joints"], group["obs/hand"] = np.ones((3, 2)), np.full((3, 2), i), np.zeros(3)
            group["rewards"] = [0.0, 1.0 * (i == 9), 0.0]
    ninth, tenth = read_motions(tmp_path / "theirs.hdf5", ["joints", "hand"])
    assert ninth.states.tolist() == [[9, 9, 0]] * 3
    assert (ninth.success, tenth.success, tenth.period) == (True, False, None)


def test_bad_data_are_named(tmp_path):
    with pytest.raises(InputError, match=r"is LeRobot's v2\.1: convert it to v3\.0"):
        read_motions(lerobot(tmp_path / "old", "v2.1"))
    path = lerobot(tmp_path / "theirs", gripper=[0, np.nan, 0, 0, 0, 0, 0])
    with pytest.raises(InputError, match=r"theirs has no hand: choose from observation\.state, .*gripper"):
        read_motions(path, ["hand"])
    with pytest.raises(InputError, match=r"episode_0 has states \(3, 1\) that are no finite rows"):
        read_motions(path, ["gripper"])
    (path / "data/chunk-000/file-000.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="is no LeRobotDataset, or a damaged one"):
        read_motions(path)
    (tmp_path / "text.hdf5").write_text("text")
    with pytest.raises(InputError, match=r"text\.hdf5 is no HDF5"):
        read_motions(tmp_path / "text.hdf5")
    with h5py.File(tmp_path / "lost.hdf5", "w") as file:
        file.create_group("data/demo_0/obs")["posture"] = np.ones((3, 2))
    with pytest.raises(InputError, match=r"lost\.hdf5 is damaged"):
        read_motions(tmp_path / "lost.hdf5")
    with h5py.File(tmp_path / "huge.hdf5", "w") as file:  # some kilobytes that claim 8 TB
        group = file.create_group("data/demo_0")
        group.create_dataset("obs/posture", shape=(10**9, 1000), dtype=float, chunks=(1, 1000))
    with pytest.raises(InputError, match=r"/data/demo_0/obs/posture has the shape .*, more than 100000 ticks"):
        read_motions(tmp_path / "huge.hdf5")


def robomimic(path, shaped=False):
    """Two demonstrations as robomimic's dataset_states_to_obs.py writes them, of a Panda; the second one fails."""
    kwargs = {"control_freq": 20, "reward_shaping": shaped, "robots": ["Panda"], "has_renderer": False}
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = 21
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "type": 1, "env_version": "1.4.1", "env_kwargs": kwargs}
        )
        for i, ticks in ((0, 10), (1, 11)):
            demo = data.create_group(f"demo_{i}")
            demo.attrs["num_samples"], demo.attrs["model_file"] = ticks, "<mujoco/>"
            demo["states"], demo["actions"] = np.zeros((ticks, 32)), np.full((ticks, 7), 0.1 * i)
            demo["rewards"] = np.append(np.full(ticks - 1, 0.2 * shaped), 1.0 - i)
            demo["dones"] = np.append(np.zeros(ticks - 1, np.int64), 1)
            for part, shift in (("obs", 0.0), ("next_obs", 1.0)):
                demo[f"{part}/robot0_joint_pos"] = np.full((ticks, 7), i + shift)
                demo[f"{part}/robot0_gripper_qpos"] = np.full((ticks, 2), i + shift)
                demo[f"{part}/agentview_image"] = np.zeros((ticks, 8, 8, 3), np.uint8)
        file["mask/train"], file["mask/valid"] = np.array([b"demo_0"]), np.array([b"demo_1"])
    return path


def test_robomimics_own_layout(tmp_path):
    path = robomimic(tmp_path / "low_dim.hdf5")
    first, second = read_motions(path, ["robot0_joint_pos", "robot0_gripper_qpos"])
    assert (first.states.shape, second.states.shape) == ((10, 9), (11, 9))
    assert (first.states.max(), second.states.min()) == (0.0, 1.0)  # none of next_obs
    assert second.actions.tolist() == [[0.1] * 7] * 11
    assert [(run.success, run.period) for run in (first, second)] == [(True, 0.05), (False, 0.05)]
    dense = read_motions(robomimic(tmp_path / "dense.hdf5", shaped=True), ["robot0_joint_pos"])
    assert [run.success for run in dense] == [None, None]  # a reward for the way there says nothing of the end
    with h5py.File(path, "r+") as file:  # as collected, before robomimic extracts the observations
        for demo in file["data"].values():
            del demo["obs"], demo["next_obs"], demo["rewards"], demo["dones"]
    with pytest.raises(InputError, match="demo_0 has no observations: let robomimic extract them from its states"):
        read_motions(path, ["robot0_joint_pos"])


def test_actions_of_those_who_convert_to_lerobot(tmp_path):
    path = lerobot(tmp_path / "theirs", state=list(np.ones((7, 2))), actions=list(np.full((7, 4), 2.0)))
    info = json.loads((path / "meta/info.json").read_text())
    del info["features"]["action"], info["features"]["observation.state"]
    (path / "meta/info.json").write_text(json.dumps(info))
    first, _ = read_motions(path, ["state"])
    assert (first.states.tolist(), first.actions.tolist()) == ([[1, 1]] * 3, [[2] * 4] * 3)
