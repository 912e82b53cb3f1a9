"""The face of a policy of one's own: units, what is left out, what it is known by, what is refused."""

import numpy as np
import pytest

from models.errors import InputError
from models.inference import own_policy
from models.policy import Decision, make_policy
from tests.models.own_policies import Drift, Recalling, Remembering

HERE = "tests.models.own_policies"


def test_step_is_scaled_and_act_is_not():
    policy = Drift()
    policy.lower, policy.upper = np.full(8, -1.0), np.full(8, 3.0)  # one scaled unit is 2 rad
    x = np.append(np.linspace(-0.5, 0.2, 8), np.linspace(-1.0, 1.0, 30))
    y, state, recalled = policy.step(x, np.zeros(0))
    np.testing.assert_allclose(y, x + 0.005 * np.eye(38)[0], atol=1e-15)  # features stay as they are
    assert (state.shape, recalled) == ((0,), None)


def test_state_and_recall():
    policy = Recalling()
    first, second = 0.1 * np.arange(9.0), 0.05 * np.arange(9.0)
    _, state, _ = policy.step(first, policy.initial_state)
    _, state, recalled = policy.step(second, state)
    np.testing.assert_allclose(state[:16], np.pi * np.append(second[:8], first[:8]))
    np.testing.assert_allclose(recalled[0], first[:8])  # a tick ago
    np.testing.assert_allclose(recalled[1], policy.scaling.scale(policy.initial_posture))


def test_what_it_decides_must_be_what_it_says():
    policy = Drift()
    for wrong in (
        Decision(np.zeros(7)), Decision(np.zeros(8), np.zeros(2)), Decision(np.zeros(8), features=np.zeros(3)),
        Decision(np.zeros(8), recalled=np.zeros((10, 8))),
    ):  # fmt: skip
        policy.act = lambda seen, state, wrong=wrong: wrong
        with pytest.raises(ValueError, match=r"drift\.act decided on .*let both agree"):
            policy.step(np.zeros(38), np.zeros(0))


def test_hash_is_of_the_source_and_the_files(tmp_path):
    (tmp_path / "weights").write_bytes(b"1")
    policy, other, third = Drift(), Drift(), Drift()
    other.files = third.files = (tmp_path / "weights",)
    assert Drift().hash == policy.hash != other.hash
    (tmp_path / "weights").write_bytes(b"2")
    assert third.hash != other.hash


def test_it_is_found_by_its_name():
    assert isinstance(make_policy(f"{HERE}:Remembering"), Remembering)
    for spec, named in (
        (f"{HERE}:NoPolicy", "is no Policy: make it a subclass"), (f"{HERE}:Nowhere", "has no initial_posture"),
        (f"{HERE}:Nobody", "cannot be loaded"), ("nowhere:Policy", "cannot be loaded"), ("lstm", "no policy 'lstm'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=named):
            make_policy(spec)


def test_without_heads_it_recalls_nothing(tmp_path):
    assert own_policy(f"{HERE}:Remembering", tmp_path).recalls is False
