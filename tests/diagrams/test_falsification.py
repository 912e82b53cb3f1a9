"""Falsification: pushes by hand, searches on a controller that is known, and scenario files that replay bit by bit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_calibrate import OUTCOME

from diagrams import falsification as f
from diagrams import rollout as rollout_module
from diagrams.draws import ONSET_LEVELS
from diagrams.episode import DisturbanceDraw, Episode
from diagrams.records import digest
from diagrams.scenario import Experimenter, Scenario, ScenarioError, World, load_scenario, save_scenario

PNG = b"\x89PNG\r\n\x1a\n"
SCENE = Episode(5, (0.555, -0.041), "left")
PUSH = f.Push(30.0, (3.0, 0, 0, 4.0, 0, 0, 0), 0.25, 5)


def test_push_by_hand():
    assert np.rad2deg(PUSH.offset) == pytest.approx([18.0, 0, 0, 24.0, 0, 0, 0])
    near, far = ONSET_LEVELS[1]
    assert (PUSH.subtask, PUSH.level) == (1, pytest.approx(0.5 * (near + far)))
    late = replace(PUSH, moment=0.5)
    assert (late.subtask, late.level) == (2, pytest.approx(ONSET_LEVELS[2][1]))
    assert PUSH.magnitude == pytest.approx(0.5 * 30 / 60 + 0.5 * 5 / 25)
    assert not np.any(replace(PUSH, direction=(0.0,) * 7).offset)


@pytest.mark.parametrize(
    ("change", "failure", "objective"),
    [
        ({"switch_failure": "not returned", "success": False}, "not returned", PUSH.magnitude),
        ({"switch_failure": "not detected", "success": False}, "not detected", PUSH.magnitude),
        # The network coped with it.
        ({"switch_failure": "not detected", "success": True, "detection_delay_s": None, "resume_s": None}, None, 2.0),
        # Noticed after 0.2 of (8 + 5 + 5) * 0.1 s; resumed after 1 of 6 s.
        ({"switch_failure": None, "detection_delay_s": 0.2, "resume_s": 1.0}, None, 1 + 5 / 6),
        ({"switch_failure": None, "detection_delay_s": 1.35, "resume_s": 1.0}, None, 1.25),
        ({"switch_failure": "false switch", "detection_delay_s": None, "resume_s": None}, None, 2.0),
    ],
)
def test_judgement(change, failure, objective):
    found = f.judge(PUSH, replace(OUTCOME, **change), 0.1)
    assert found == (failure, pytest.approx(objective))


class Nominal:
    """At home all the time."""

    def __init__(self, joints):
        self._joints = joints

    def command_at(self, subtask, level):
        return None if subtask == 2 else self._joints


def test_only_what_an_experimenter_could_do_is_a_disturbance(world):
    builder = f.PushBuilder(world, SCENE, Nominal(world.initial_posture[:7]))
    draw = builder.disturbance(replace(PUSH, size_deg=10.0))
    assert (draw.kind, draw.subtask, draw.hold_ticks, draw.can_moved_to) == ("A", 1, 5, None)
    off = np.rad2deg(np.array(draw.target_joints) - world.initial_posture[:7])
    assert np.linalg.norm(off) == pytest.approx(10.0)
    assert builder.disturbance(replace(PUSH, moment=0.75)) is None  # the moment does not come
    assert builder.disturbance(replace(PUSH, size_deg=60.0)) is None  # joint 4 has 22 deg to its limit


def test_nominal_commands_by_hand(world, hand):
    n = 4
    joints = np.array([world.initial_posture + 0.1 * k for k in range(n)])
    goal = hand.grasp_position(joints[3, :7])
    record = type("R", (), {})()
    record.can_poses = np.tile(np.concatenate(([1, 0, 0, 0], goal, np.zeros(7))), (n, 1))
    record.posture, record.desired_posture = joints, joints + 0.01
    nominal = f.NominalRun.of(record, hand, goal + [0, 0, 1.0])
    between = 0.5 * (nominal.distances[1][1] + nominal.distances[1][2])
    assert nominal.command_at(1, between) == pytest.approx(joints[1, :7] + 0.01)
    assert nominal.command_at(2, 0.5) is None


def fake_run(push, disturbance):
    """Fails from 20 deg and 10 ticks on."""
    fails = push.size_deg > 20.0 and push.hold_ticks > 10
    objective = push.magnitude if fails else 1.0 + (20.0 - min(push.size_deg, 20.0)) / 20.0
    kind = "not returned" if fails else None
    return f.Trial(push, disturbance, kind, kind, not fails, objective, 0.2, push.size_deg, "d")


def fake_build(push):
    return None if push.direction[0] > 0.5 else DisturbanceDraw("A", 1, 0.1, (0.0,) * 7, push.hold_ticks)


def test_searches_have_the_same_budget_and_their_seed(tmp_path):
    found = f.search_all(fake_build, fake_run, 25, 3)
    assert {name: len(trials) for name, trials in found.items()} == {"tpe": 25, "cmaes": 25, "random": 25}
    assert all(trial.push.direction[0] <= 0.5 for trials in found.values() for trial in trials)
    seen = {"random": [], "tpe": []}
    again = f.search_all(
        fake_build, fake_run, 25, 3, ("random", "tpe"), on_trial=lambda name, trial: seen[name].append(trial)
    )
    assert seen == again
    assert again["tpe"] == found["tpe"]
    assert again["random"] == found["random"]
    files = {(n, k): f"{n}-{k}.yaml" for n, trials in found.items() for k, t in enumerate(trials) if t.failure}
    report = f.report(found, files, SCENE)
    for name, trials in found.items():
        first = next((k for k, trial in enumerate(trials, 1) if trial.failure), None)
        assert report["trials_to_first"][name] == first
    sizes = [case["magnitude"] for case in report["counterexamples"]]
    assert sizes == sorted(sizes)
    assert len(sizes) == len(files) > 0
    json.dumps(report, allow_nan=False)
    f.save_search(found, tmp_path / "falsify.png")
    assert (tmp_path / "falsify.png").read_bytes().startswith(PNG)


def test_a_search_without_any_disturbance_ends():
    assert f.search(f.make_sampler("random", 0), lambda push: None, fake_run, 2) == []


def test_an_error_in_a_search_is_not_lost():
    def broken(push, disturbance):
        raise RuntimeError("the plant broke")

    with pytest.raises(RuntimeError, match="the plant broke"):
        f.search_all(fake_build, broken, 1, 0, ("random",))


def test_scenario_gives_the_same_bits_back(tmp_path, draws):
    for seed, kind in ((0, "A"), (3, "B"), (4, "B"), (1, "none")):
        episode = draws.draw(seed, kind)
        save_scenario(tmp_path / "s.yaml", f.scenario_of(World(), episode, episode.disturbance))
        scenario = load_scenario(tmp_path / "s.yaml")
        scenario.check()
        if kind == "none":
            scenario.experimenter = Experimenter()
        assert draws.episode(scenario) == episode


def test_nothing_given_is_drawn(draws):
    assert draws.episode(Scenario(seed=3, disturbance="B")) == draws.draw(3, "B")
    assert draws.episode(Scenario(seed=3, can=[0.5, 0.02])) == draws.draw(3, "A", can_xy=(0.5, 0.02))


@pytest.mark.parametrize(
    ("given", "kind", "named"),
    [
        ({"hold_ticks": 3}, "A", "experimenter.level is missing"),
        ({"level": -0.1}, "B", "no distance"),
        ({"level": 0.1, "subtask": 3}, "B", "no subtask 3"),
        ({"level": 0.1}, "B", "too short"),
        ({"level": 0.1}, "A", "7 joint angles"),
        ({"level": 0.1, "hold_ticks": 9, "target": [0.0] * 7}, "B", "0 joint angles"),
        ({"level": 0.1, "hold_ticks": 9, "can_moved_to": [0.5]}, "B", "two numbers"),
        ({"level": 0.1, "hold_ticks": 9, "can_moved_to": [0.5, float("nan")]}, "B", "two numbers"),
    ],
)
def test_what_is_no_disturbance_is_named(given, kind, named):
    with pytest.raises(ScenarioError, match=named):
        Scenario(disturbance=kind, experimenter=Experimenter(**given)).check()


@pytest.mark.parametrize(
    ("given", "kind", "named"),
    [
        (
            {"target": [100.0, *[0.0] * 6]},
            "A",
            r"target \[100\.0, .* outside of the joint limits: choose from \[-2\.79",
        ),
        ({"hold_ticks": 9, "can_moved_to": [0.9, 0.0]}, "B", r"\(0\.900, 0\.000\) m is out of reach"),
    ],
)
def test_what_the_arm_cannot_do_is_no_episode(draws, given, kind, named):
    scenario = Scenario(disturbance=kind, experimenter=Experimenter(level=0.1, **given))
    scenario.check()
    with pytest.raises(ScenarioError, match=named):
        draws.episode(scenario)


def test_counterexample_replays_bit_by_bit(rollout, policy, world, draws, tmp_path, monkeypatch):
    """A push in the closed loop with fakes; its file, run as pick_place.py does."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 12.0)
    target = tuple(float(q) for q in world.initial_posture[:7] + np.deg2rad([10.0, 0, 0, -10.0, 0, 0, 0]) / 3)
    draw = DisturbanceDraw("A", 1, 0.18, target, 4)
    policy.learn(SCENE)
    trial = f.Falsifier(rollout, SCENE).run(replace(PUSH, hold_ticks=4), draw)
    assert trial.moved_deg > 1.0
    save_scenario(tmp_path / "s.yaml", f.scenario_of(world, SCENE, draw))
    episode = draws.episode(load_scenario(tmp_path / "s.yaml"))
    policy.learn(episode)
    _, record = rollout.run(episode)
    assert digest(record) == trial.digest
    undisturbed = replace(SCENE, disturbance=DisturbanceDraw())
    policy.learn(undisturbed)
    assert digest(rollout.run(undisturbed)[1]) != trial.digest
