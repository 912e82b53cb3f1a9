"""The face of a policy of one's own: units, what is left out, what it is known by, what is refused."""

import numpy as np
import pytest

from models.errors import InputError
from models.inference import own_policy
from models.policy import Decision, make_policy
from tests.models.own_policies import Curious, Drift, Recalling, Remembering

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
        (f"{HERE}:WithArgument", "cannot be made.*file.*takes no argument"),
        (f"{HERE}:WithoutAct", "cannot be made.*abstract.* '?act"), (f"{HERE}:Nobody", "cannot be loaded"),
        ("nowhere:Policy", "cannot be loaded"), ("lstm", "no policy 'lstm'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=named):
            make_policy(spec)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"initial_posture": np.full(8, np.nan)}, "no initial_posture"),
        ({"initial_posture": np.zeros((2, 4))}, "no initial_posture"),
        ({"lower": np.zeros(7)}, r"bounds lower .*give \(8,\) numbers"),
        ({"lower": 4.0}, "bounds lower 4.0"),
        ({"upper": np.inf}, "bounds lower .* upper inf"),
        ({"initial_state": np.array([np.nan])}, "no initial_state"),
        ({"horizon": 0}, "has the horizon 0"),
        ({"feature_size": 1.5}, "has the feature_size 1.5"),
        ({"files": ("nowhere.npz",)}, "has no file nowhere.npz"),
        ({"act": lambda self, seen, state: None}, r"Drift' does not act \(AttributeError"),
        ({"act": lambda self, seen, state: 1 / 0}, r"drift\.act raised ZeroDivisionError"),
        ({"act": lambda self, seen, state: Decision(np.zeros(7))}, r"drift\.act decided on posture \(7,\)"),
        ({"act": lambda self, seen, state: Decision(np.full(8, np.nan))}, "not finite"),
        ({"encode": lambda self, picture: np.zeros(2)}, r"encode gives \(2,\), feature_size is 30"),
    ],
)
def test_one_that_does_not_do_as_it_says_is_refused(monkeypatch, change, named):
    for name, value in change.items():
        monkeypatch.setattr(Drift, name, value, raising=False)
    with pytest.raises(InputError, match=named):
        make_policy(f"{HERE}:Drift")


def test_a_recall_of_another_shape_is_refused(monkeypatch):
    monkeypatch.setattr(Recalling, "horizon", 3)
    with pytest.raises(InputError, match=r"recalled \(2, 8\); it says .*recalled \(3, 8\)"):
        make_policy(f"{HERE}:Recalling")


def test_what_answers_by_features_names_its_encoder(monkeypatch):
    with pytest.raises(InputError, match="give it encoder_hash"):
        make_policy(f"{HERE}:Curious")
    monkeypatch.setattr(Curious, "encoder_hash", "abc")
    assert make_policy(f"{HERE}:Curious").encoder_hash == "abc"


def test_a_changed_base_class_changes_the_hash(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_base.py").write_text("from tests.models.own_policies import Drift\nclass Base(Drift): pass\n")
    (tmp_path / "my_policy.py").write_text("from my_base import Base\nclass Mine(Base): pass\n")
    before = make_policy("my_policy:Mine").hash
    with (tmp_path / "my_base.py").open("a") as file:
        file.write("# changed\n")
    assert make_policy("my_policy:Mine").hash != before


def test_without_heads_it_recalls_nothing(tmp_path):
    assert own_policy(f"{HERE}:Remembering", tmp_path).recalls is False


def test_a_module_that_raises_and_an_act_that_does_are_named(tmp_path, monkeypatch):
    (tmp_path / "no_module.py").write_text("raise RuntimeError('boom')\n")
    (tmp_path / "no_python.py").write_text("def (\n")
    monkeypatch.syspath_prepend(tmp_path)
    for spec, named in (("no_module:X", "cannot be loaded.*RuntimeError: boom"), ("no_python:X", "SyntaxError")):
        with pytest.raises(InputError, match=named):
            make_policy(spec)
    policy = Drift()
    monkeypatch.setattr(policy, "act", lambda seen, state: {}["late"])
    with pytest.raises(InputError, match=r"drift\.act raised KeyError: 'late'"):
        policy.step(np.zeros(38), np.zeros(0))
