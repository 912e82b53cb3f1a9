"""The requirements say of the switching what the scoring says, after each tick; in the loop they change no bit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.primitives import ConstantVectorSource

from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.episode import Episode
from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.switching import DETECTED, GUARD, RESUMED, Switching
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.requirements import SIGNALS, broken, requirements, robustness_of
from tests.campaigns.stl import FAILURES, failure_of, record_agrees

PERIOD = 0.1
CAN = (0.555, -0.041)


def signals_of(alpha, active, home, crossings=0.0, clearance=0.05, position=0.1, speed=0.1):
    """(n, 7) of a run made up."""
    values = {"alpha": alpha, "active": active, "home": home, "crossings": crossings, "clearance": clearance,
              "position_margin": position, "speed_margin": speed}  # fmt: skip
    return np.column_stack([np.broadcast_to(np.asarray(values[name], float), np.shape(alpha)) for name in SIGNALS])


LEVELS = st.sampled_from([0.0, RESUMED, np.nextafter(RESUMED, 1.0), 0.3, np.nextafter(GUARD, 0.0), GUARD,
                          np.nextafter(DETECTED, 0.0), DETECTED, 1.0])  # fmt: skip
PIECES = st.lists(st.tuples(LEVELS, st.booleans(), st.integers(1, 70)), min_size=1, max_size=8)


@settings(max_examples=60, deadline=None)
@given(PIECES, st.integers(0, 60), st.integers(0, 30), st.booleans())
def test_after_each_tick_the_requirements_say_what_the_scoring_says(pieces, onset, length, disturbed):
    repeats = [length for *_, length in pieces]
    alpha, home = (np.repeat([piece[i] for piece in pieces], repeats) for i in (0, 1))
    ticks = np.arange(len(alpha))
    active = (ticks >= onset) & (ticks < onset + length) & disturbed
    signals, switching = signals_of(alpha, active, home), Switching(disturbed, PERIOD)
    for n in range(1, len(alpha) + 1):
        switching.see(float(alpha[n - 1]), bool(active[n - 1]), bool(home[n - 1]))
        if n % 3 == 0 or n == len(alpha):
            assert failure_of(signals[:n], PERIOD) == switching.failure, n
    values = robustness_of(signals, PERIOD)
    for name in FAILURES:
        assert values[name] == 0.0 or (values[name] < 0.0) == (name in broken(signals, PERIOD))


def whole(n=200, **changes):
    """Disturbed in 50 to 67, alpha 1 from 52 to 120, at home from 100 on."""
    ticks = np.arange(n)
    values = {
        "alpha": np.where((ticks >= 52) & (ticks < 121), 1.0, 0.02), "active": (ticks >= 50) & (ticks < 68),
        "home": ticks >= 100,
    }  # fmt: skip
    return signals_of(**values | changes)


def test_robustness_by_hand():
    assert robustness_of(whole(), PERIOD) == pytest.approx(
        {"no_false_switch": 0.48, "notices": 0.1, "returns": 0.1, "resumes": 0.08, "no_later_switch": 0.48,
         "no_chatter": 4.0, "clearance": 0.05, "command_position": 0.1, "command_speed": 0.1}
    )  # fmt: skip
    assert broken(whole(), PERIOD) == []


@pytest.mark.parametrize(
    ("changes", "name", "value"),
    [
        ({"crossings": 5.0}, "no_chatter", -1.0),
        ({"crossings": 4.0}, None, None),
        ({"clearance": -0.002}, "clearance", -0.002),
        ({"clearance": 0.0}, "clearance", 0.0),
        ({"position": -0.1}, "command_position", -0.1),
        ({"position": -1e-15}, None, None),  # rounding
        ({"speed": -0.1}, "command_speed", -0.1),
        ({"home": 0.0}, "returns", -0.1),  # by as little it would not have noticed, and owed no return
    ],
)
def test_each_requirement_can_be_broken(changes, name, value):
    signals = whole(**changes)
    assert broken(signals, PERIOD) == ([] if name is None else [name])
    if name is not None:
        assert robustness_of(signals, PERIOD)[name] == pytest.approx(value, abs=1e-8)


def test_all_that_is_said_of_switching_is_required_once():
    assert list(requirements(PERIOD))[: len(FAILURES)] == list(FAILURES)


# In the loop.


def episode(kind):
    """Stopped, or moved away, on the way to the can."""
    spec = {
        "none": DisturbanceSpec(),
        "B": DisturbanceSpec("B", 0.12, None, 15, 1),
        "A": DisturbanceSpec("A", 0.15, [0.2, 0.5, 0.1, 1.0, 0.1, 1.0, 0.1], 10, 1),
    }[kind]
    return Episode(0, CAN, "left", spec)


@pytest.fixture(scope="module", params=["none", "A", "B"])
def run(request, rollout, policy):
    given = episode(request.param)
    policy.learn(given)
    outcome, record = rollout.run(given, time_limit=14.0)
    return outcome, record, rollout.requirements.robustness(rollout.simulator.get_context())


def test_in_the_loop_they_say_what_the_scoring_says(run):
    outcome, record, watched = run
    found = robustness_of(record.signals, PERIOD)
    assert watched == found  # to the bit
    assert failure_of(record.signals, PERIOD) == outcome.switch_failure
    assert (min(found[name] for name in FAILURES) > 0.0) is outcome.switch_success
    columns = dict(zip(SIGNALS, record.signals.T, strict=True))
    for name in ("alpha", "active"):
        assert np.array_equal(columns[name], getattr(record, name))
    high = np.append(0.0, record.alpha >= GUARD)
    crossed = np.abs(np.diff(high))
    assert np.array_equal(columns["crossings"], [crossed[max(0, k - 9) : k + 1].sum() for k in range(len(crossed))])
    if outcome.way_home_m is not None:
        # Scoring looks after each step of the plant, the requirement at the ticks.
        assert outcome.way_home_m <= columns["clearance"].min() + 1e-3


@pytest.mark.parametrize(("kind", "judged"), [("push_hand", True), ("camera_gain", False), ("disturbed_return", False)])
def test_of_a_fault_they_say_what_the_scoring_says_where_it_says_something(kind, judged, world, encoder, policy):
    given, target = episode("A"), episode("A").disturbance.target
    spec = DisturbanceSpec(kind, 0.12, subtask=1, hold_ticks=0 if kind == "camera_gain" else 10)
    spec.target = [*target, *np.add(target, 0.2)] if kind == "disturbed_return" else None
    spec.check()
    given = dataclasses.replace(given, disturbance=spec)
    policy.learn(given)
    outcome, record = Rollout(world, encoder, policy, fault=kind).run(given, time_limit=14.0)
    assert outcome.judged is judged
    assert not outcome.void
    if judged:
        assert failure_of(record.signals, PERIOD) == outcome.switch_failure
        assert record.active.any()
    else:
        assert (outcome.switch_success, outcome.switch_failure) == (None, None)
    assert record_agrees(record.signals, record.time, outcome.to_dict()) is None


def test_a_clone_goes_on_to_the_same_robustness(rollout, policy):
    given = episode("B")
    policy.learn(given)
    rollout.prepare(given)
    rollout.advance(3.05)
    root = rollout.simulator.get_context()
    clone = root.Clone()

    def values():
        rollout.advance(9.05)
        return list(rollout.requirements.robustness(rollout.simulator.get_context()).values())

    first = values()
    rollout.simulator.reset_context(clone)
    assert values() == first
    assert rollout.requirements.robustness(root) == dict(zip(requirements(PERIOD), first, strict=True))


def test_watching_changes_no_bit(run, world, encoder, policy, monkeypatch):
    """Without any of the systems that watch; a constant where the record has the signals."""

    class Nothing:
        def __init__(self, builder, *_):
            self.signals = builder.AddSystem(ConstantVectorSource(np.zeros(len(SIGNALS)))).get_output_port()

    _, watched, _ = run
    monkeypatch.setattr(rollout_module, "RequirementWatch", Nothing)
    given = episode("B" if watched.active.sum() == 15 else "A" if watched.active.any() else "none")
    policy.learn(given)
    _, alone = Rollout(world, encoder, policy).run(given, time_limit=14.0)
    assert record_hash(alone) != record_hash(watched)
    assert record_hash(dataclasses.replace(alone, signals=watched.signals)) == record_hash(watched)
