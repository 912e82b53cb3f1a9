"""The Gymnasium environment: its checker, seeds, two in processes, and the bits of a run of our own."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv
from pydrake.gym import DrakeGymEnv

from diagrams.episodes import gym_env
from diagrams.episodes.calibration import never_fires
from diagrams.episodes.episode import Episode
from diagrams.episodes.gym_env import PickPlaceEnv
from diagrams.world.configuration import Camera, World
from diagrams.world.disturbance import DisturbanceSpec
from models.command_line import ROOT
from models.errors import InputError

NAME = f"{gym_env.__name__}:{gym_env.NAME}"
CAN = (0.555, -0.041)


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make(NAME, disable_env_checker=True)
    yield made
    made.close()


def actions(n, seed=0):
    """Postures that wander around the initial one."""
    steps = np.random.default_rng(seed).normal(scale=0.02, size=(n, 8)) * np.append(np.ones(7), 0.1)
    return World().initial_posture + np.cumsum(steps, axis=0)


def run(env, seed, n=5):
    """All that comes out of n ticks, as bytes."""
    seen, information = env.reset(seed=seed)
    found = [seen["rgb"].tobytes(), seen["posture"].tobytes(), information["can_poses"].tobytes()]
    for action in actions(n):
        seen, reward, _, _, information = env.step(action)
        found += [seen["rgb"].tobytes(), seen["posture"].tobytes(), information["can_poses"].tobytes(), reward]
    return found


def test_gymnasium_s_checker_has_no_complaint():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(gymnasium.make(NAME, render_mode="rgb_array", disturbance="A").unwrapped)
    # It recommends actions from -1 to 1, as gymnasium.wrappers.RescaleAction makes of ours.
    complaints = [str(w.message) for w in said if "symmetric and normalized" not in str(w.message)]
    assert [words for words in complaints if "WARN" in words] == []


def test_its_name_is_enough():
    """In a fresh process, which has imported nothing of ours."""
    code = f"import gymnasium; print(type(gymnasium.make('{NAME}').unwrapped).__name__)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "PickPlaceEnv\n"
    assert NAME == "diagrams.episodes.gym_env:Hindsight/PickPlace-v0"  # as the pages say


def test_spaces(env):
    seen, information = env.reset(seed=3)
    assert env.observation_space.contains(seen)
    assert seen["rgb"].shape == (112, 112, 3)
    assert seen["posture"] == pytest.approx(World().initial_posture)
    assert env.action_space.shape == (8,)
    assert (information["seed"], information["success"], information["disturbed"]) == (3, False, False)


def test_the_same_seed_gives_the_same_bits(env):
    first, other = run(env, 5), run(env, 6)
    assert run(env, 5) == first
    assert other[0] != first[0]
    again = gymnasium.make(NAME, disable_env_checker=True)
    assert run(again, 5) == first


def test_without_a_seed_scenes_differ_and_follow_from_the_last_one(env):
    def scenes():
        return [env.reset(seed=1 if k == 0 else None)[1]["can_poses"].tobytes() for k in range(3)]

    found = scenes()
    assert len(set(found)) == 3
    assert scenes() == found


def test_two_at_once_in_processes(env):
    vector = AsyncVectorEnv([lambda: gymnasium.make(NAME, disable_env_checker=True)] * 2)
    try:
        vector.reset(seed=5)
        seen = [vector.step(np.stack([action, action]))[0] for action in actions(2)][-1]
    finally:
        vector.close()
    for i, seed in enumerate((5, 6)):
        alone = run(env, seed, 2)
        assert seen["rgb"][i].tobytes() == alone[-4]
        assert seen["posture"][i].tobytes() == alone[-3]


@pytest.fixture(scope="module")
def disturbed():
    """B in subtask 2, in which the can is taken from the hand."""
    return DisturbanceSpec("B", 0.12, None, 20, 2, [0.5, 0.03])


@pytest.mark.parametrize("kind", ["none", "B"])
def test_it_is_the_loop_that_we_run(rollout, policy, disturbed, kind):
    """The commands of a run of ours lead to its postures, to rounding, to its cans, and to its end."""
    episode = Episode(0, CAN, "left", DisturbanceSpec() if kind == "none" else disturbed)
    policy.learn(episode)
    outcome, record = rollout.run(episode, calibration=never_fires(11), time_limit=60.0 if kind == "none" else 25.0)
    assert outcome.success == (kind == "none")
    given = "none" if kind == "none" else vars(disturbed)
    env = gymnasium.make(NAME, can=CAN, vacant="left", disturbance=given, disable_env_checker=True).unwrapped
    seen, _ = env.reset(seed=0)
    ended, was_disturbed = None, []
    for k, command in enumerate(record.desired_posture):
        # The record's was scaled and back: contacts would make more of any other difference.
        np.testing.assert_allclose(seen["posture"], record.posture[k], rtol=0.0, atol=1e-14)
        seen, reward, terminated, truncated, information = env.step(command)
        was_disturbed.append(information["disturbed"])
        # Ours are from the middle of the tick.
        assert np.abs(information["can_poses"] - record.can_poses[k]).max() < 0.05
        if terminated or truncated:
            ended = k, reward, terminated
            break
    assert was_disturbed == (record.active[: len(was_disturbed)] > 0.5).tolist()
    if kind == "none":
        assert ended is not None
        assert ended[0] == len(record.time) - 2  # what is seen after it is the last row
        assert ended[1:] == (1.0, True)
    else:
        assert ended is None
        assert sum(was_disturbed) == 20
        assert information["can_poses"][4:6] == pytest.approx([0.5, 0.03], abs=0.01)


def test_time_is_limited(monkeypatch):
    monkeypatch.setattr(gym_env, "TIME_LIMIT", 2.0)
    env = gymnasium.make(NAME, world=World(camera=Camera(width=113, height=113)), disable_env_checker=True)
    env.reset(seed=0)
    ends = [env.step(World().initial_posture) for _ in range(20)]
    assert [bool(end[3]) for end in ends] == [False] * 19 + [True]
    assert not any(end[2] for end in ends)
    assert ends[0][0]["rgb"].shape == (112, 112, 3)  # of a larger picture


def test_a_diverged_tick_has_all_of_the_information(env, monkeypatch):
    env.reset(seed=0)
    before = env.step(World().initial_posture)[4]
    monkeypatch.setattr(DrakeGymEnv, "step", lambda self, action: (None, 0.0, False, True, {}))
    _, reward, ended, cut, information = env.unwrapped.step(World().initial_posture)
    assert (reward, ended, cut, information.keys()) == (0.0, False, True, before.keys())


def test_a_world_s_file_is_taken():
    made = PickPlaceEnv(world=ROOT / "sdf" / "iiwa.world.yaml")
    assert made.reset(seed=0)[0]["posture"] == pytest.approx(np.append(np.deg2rad([28, 32, 0, -96, 0, 47, 0]), 0.08))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"disturbance": "C"}, "no disturbance 'C'"),
        ({"disturbance": "camera_shift"}, "has no fault 'camera_shift'"),
        ({"disturbance": {"kinds": "A"}}, "does not fit.*kinds"),
        ({"vacant": "middle"}, "no vacant spot 'middle'"),
        ({"can": [0.5]}, "does not have two numbers"),
        ({"can": ["x", 0.1]}, "the can .* does not fit"),
        ({"can": 3}, "the can 3 does not fit"),
        ({"disturbance": 3}, "the disturbance 3 is none"),
        ({"disturbance": {"kind": "B", "level": "x"}}, "the disturbance .*level='x'.* does not fit"),
        ({"world": "nowhere.yaml"}, "no world file nowhere.yaml"),
        ({"world": 3}, "the world 3 is none"),
        ({"render_mode": "human"}, "no render_mode 'human'"),
    ],
)
def test_bad_options_are_named(options, named):
    with pytest.raises(InputError, match=named):
        PickPlaceEnv(**options)


def test_bad_input_in_a_run_is_named(env):
    env.reset(seed=0)
    for action in (np.zeros(7), np.full(8, np.nan)):
        with pytest.raises(InputError, match="give 8 finite numbers"):
            env.unwrapped.step(action)
    with pytest.raises(InputError, match="there are no options"):
        env.reset(options={"can": [0.5, 0.0]})
    with pytest.raises(InputError, match="nothing is rendered without"):
        env.unwrapped.render()
    far = PickPlaceEnv(can=[0.9, 0.0])
    with pytest.raises(InputError, match="out of reach"):
        far.reset(seed=0)
