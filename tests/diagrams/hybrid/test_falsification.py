"""Falsification: pushes by hand, searches on a controller that is known, and scenario files that replay bit by bit."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams import analysis, pick_place
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.episode import Episode
from diagrams.episodes.record import load_record, record_hash
from diagrams.episodes.sampling import ONSET_LEVELS
from diagrams.hybrid import falsification, falsification_report
from diagrams.hybrid.falsification import Trial, TrialLog
from diagrams.hybrid.perturbations import FORMS, NominalRun, Push, PushBuilder, judge
from diagrams.world.configuration import World
from diagrams.world.disturbance import Disturbance
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import Scenario, load_scenario, save_scenario
from models.errors import InputError
from models.files.weights import load_policy, save_policy
from tests.diagrams.episode_fakes import OUTCOME

PNG = b"\x89PNG\r\n\x1a\n"
SCENE = Episode(5, (0.555, -0.041), "left")
PUSH = Push("push", 30.0, (3.0, 0, 0, 4.0, 0, 0, 0), 0.25, 5)
GAMMA = 10.0


def test_push_by_hand():
    assert np.rad2deg(PUSH.offset) == pytest.approx([18.0, 0, 0, 24.0, 0, 0, 0])
    near, far = ONSET_LEVELS[1]
    assert (PUSH.subtask, PUSH.level) == (1, pytest.approx(0.5 * (near + far)))
    late = replace(PUSH, moment=0.5)
    assert (late.subtask, late.level) == (2, pytest.approx(ONSET_LEVELS[2][1]))
    assert PUSH.ticks == 8 + 5
    assert PUSH.magnitude == pytest.approx(0.5 * 30 / 60 + 0.5 * 13 / 33)
    assert not np.any(replace(PUSH, direction=(0.0,) * 7).offset)


def propose(**given):
    middle = {"form": 0.1, "size_deg": 30.0, "moment": 0.75, "hold_ticks": 3.4, "scene": 0.6, "place_x": 0.0}
    return Push.propose(lambda name, low, high: {**middle, **given}.get(name, 0.5), 4)


def test_proposals_by_hand():
    push = propose()
    assert (push.form, push.size_deg, push.hold_ticks, push.ticks, push.scene) == ("push", 30.0, 3, 11, 2)
    stop = propose(form=0.5)
    assert (stop.form, stop.size_deg, stop.ticks, stop.magnitude) == ("stop", 0.0, 3, pytest.approx(0.5 * 3 / 33))
    assert propose(form=0.5, hold_ticks=0.0).ticks == 1  # no time at all is no stop
    taken = propose(form=0.9)
    assert (taken.form, taken.ticks, taken.place) == ("taken", 5, (0.0, 0.5))
    assert propose(form=0.9, moment=0.2).form == "stop"  # nothing is in the hand yet
    assert propose(scene=0.9999).scene == 3


def run_record(worst):
    """Five ticks undisturbed, three stopped, then on; `worst`: the largest error at each of twelve ticks."""
    errors = np.tile(np.asarray(worst, float)[:, None], 11)
    alpha = (np.asarray(worst) > GAMMA).astype(float)
    active = np.array([False] * 5 + [True] * 3 + [False] * 4)
    return SimpleNamespace(errors=errors, alpha=alpha, active=active)


FAR = [0.1] * 5 + [1000.0] * 7


@pytest.mark.parametrize(
    ("change", "worst", "failure", "objective"),
    [
        ({"switch_failure": "not returned", "success": False}, FAR, "not returned", PUSH.magnitude),
        ({"switch_failure": "not detected", "success": False}, FAR, "not detected", PUSH.magnitude),
        # The network coped with it: the error rose to a hundredth, then to a tenth of the threshold, of two decades.
        ({"switch_failure": "not detected"}, [0.1] * 12, None, 2.0),
        ({"switch_failure": "not detected"}, [0.1] * 6 + [1.0] * 6, None, 1.5),
        # Noticed after 0.2 of (8 + 5 + 5) * 0.1 s; resumed after 1 of 6 s.
        ({"detection_delay_s": 0.2, "resume_s": 1.0}, FAR, None, 1 + 5 / 6),
        ({"detection_delay_s": 1.35, "resume_s": 1.0}, FAR, None, 1.25),
        # Home two ticks after the end, at tick 10, with the error down to twice the threshold at tick 9.
        ({"detection_delay_s": 0.2, "resume_s": 1.0, "return_s": 0.2}, [*FAR[:9], 20.0, 1e3, 1e3], None,
         1 + np.log10(2) / 2),
    ],
)  # fmt: skip
def test_judgement(change, worst, failure, objective):
    quiet = {"detection_delay_s": None, "resume_s": None, "return_s": None}
    found = judge(PUSH, replace(OUTCOME, **(quiet | change)), run_record(worst), 0.1, GAMMA)
    assert found == (failure, pytest.approx(objective))


class Nominal:
    """At home all the time."""

    def __init__(self, joints, subtask=1):
        self._joints, self._subtask = joints, subtask

    def command_at(self, subtask, level):
        return self._joints if subtask == self._subtask else None


def test_only_what_an_experimenter_could_do_is_a_disturbance(world):
    builder = PushBuilder(world, SCENE, Nominal(world.initial_posture[:7]))
    draw = builder.disturbance(replace(PUSH, size_deg=10.0))
    assert (draw.kind, draw.subtask, draw.hold_ticks, draw.can_moved_to) == ("A", 1, 5, None)
    off = np.rad2deg(np.array(draw.target_joints) - world.initial_posture[:7])
    assert np.linalg.norm(off) == pytest.approx(10.0)
    assert builder.disturbance(replace(PUSH, moment=0.75)) is None  # the moment does not come
    assert builder.disturbance(replace(PUSH, size_deg=60.0)) is None  # joint 4 has 22 deg to its limit
    stop = replace(PUSH, form="stop", size_deg=0.0)
    assert builder.disturbance(stop) == Disturbance("B", 1, PUSH.level, None, 5)


def test_the_can_is_put_on_the_grid(world, draws):
    builder = PushBuilder(world, SCENE, Nominal(world.initial_posture[:7], subtask=2))
    lower, upper = world.grid.bounds
    for place, xy in (((0.0, 0.0), lower), ((1.0, 1.0), upper), ((0.5, 0.5), 0.5 * (lower + upper))):
        draw = builder.disturbance(replace(PUSH, form="taken", size_deg=0.0, moment=0.75, place=place))
        assert (draw.kind, draw.subtask, draw.target_joints) == ("B", 2, None)
        assert draw.can_moved_to == pytest.approx(tuple(xy))
        draws.require_reachable(draw.can_moved_to)


def test_nominal_commands_by_hand(world, hand):
    n = 4
    joints = np.array([world.initial_posture + 0.1 * k for k in range(n)])
    goal = hand.grasp_position(joints[3, :7])
    record = type("R", (), {})()
    record.can_poses = np.tile(np.concatenate(([1, 0, 0, 0], goal, np.zeros(7))), (n, 1))
    record.posture, record.desired_posture = joints, joints + 0.01
    nominal = NominalRun.of(record, hand, goal + [0, 0, 1.0])
    between = 0.5 * (nominal.distances[1][1] + nominal.distances[1][2])
    assert nominal.command_at(1, between) == pytest.approx(joints[1, :7] + 0.01)
    assert nominal.command_at(2, 0.5) is None


def fake_run(push, disturbance):
    """Fails from 20 deg and 10 ticks on."""
    fails = push.size_deg > 20.0 and push.hold_ticks > 10
    objective = push.magnitude if fails else 1.0 + (20.0 - min(push.size_deg, 20.0)) / 20.0
    kind = "not returned" if fails else None
    return Trial(push, disturbance, kind, kind, not fails, objective, 0.2, push.size_deg, "d")


def fake_build(push):
    return None if push.moment > 0.9 else Disturbance("A", 1, 0.1, (0.0,) * 7, push.hold_ticks)


def search_all(path, trials=25, run=fake_run, samplers=falsification.SAMPLERS, seed=3, **more):
    log = TrialLog(path / "trials.jsonl", {"seed": seed})
    return falsification.search_all(2, fake_build, run, trials, seed, log, samplers, **more)


def test_searches_have_the_same_budget_and_their_seed(tmp_path):
    found = search_all(tmp_path)
    assert {name: len(trials) for name, trials in found.items()} == {"tpe": 25, "cmaes": 25, "random": 25}
    everything = [trial.push for trials in found.values() for trial in trials]
    assert all(push.moment <= 0.9 for push in everything)
    assert {push.form for push in everything} == set(FORMS)
    assert {push.scene for push in everything} == {0, 1}
    (tmp_path / "again").mkdir()
    seen = {"random": [], "tpe": []}
    again = search_all(
        tmp_path / "again", samplers=("random", "tpe"), on_trial=lambda name, number, trial: seen[name].append(trial)
    )
    assert seen == again
    assert again["tpe"] == found["tpe"]
    assert again["random"] == found["random"]
    files = {(n, k): f"{n}-{k}.yaml" for n, trials in found.items() for k, t in enumerate(trials) if t.failure}
    report = falsification_report.report(found, files, [SCENE, SCENE])
    for name, trials in found.items():
        first = next((k for k, trial in enumerate(trials, 1) if trial.failure), None)
        assert report["trials_to_first"][name] == first
    sizes = [case["magnitude"] for case in report["counterexamples"]]
    assert sizes == sorted(sizes)
    assert len(sizes) == len(files) > 0
    json.dumps(report, allow_nan=False)
    falsification_report.save_search(found, tmp_path / "falsify.png")
    assert (tmp_path / "falsify.png").read_bytes().startswith(PNG)


def test_a_search_that_was_killed_goes_on(tmp_path):
    whole = search_all(tmp_path)
    path = tmp_path / "trials.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:41]) + lines[41][:50])  # the kill came in the middle of a line
    ran = []

    def run(push, disturbance):
        ran.append(push)
        return fake_run(push, disturbance)

    assert search_all(tmp_path, run=run) == whole
    assert len(ran) == 3 * 25 - 40
    ran.clear()
    longer = search_all(tmp_path, trials=30, run=run)
    assert len(ran) == 3 * 5
    assert {name: trials[:25] for name, trials in longer.items()} == whole
    with pytest.raises(InputError, match=r"trials\.jsonl is of another search .*: choose another --out"):
        search_all(tmp_path, seed=4)


def test_a_search_without_any_disturbance_ends():
    sampler = falsification.make_sampler("random", 0)
    assert falsification.search(sampler, 1, lambda push: None, lambda *_: None, 2) == []


def test_an_error_in_a_search_is_not_lost(tmp_path):
    def broken(push, disturbance):
        raise RuntimeError("the plant broke")

    with pytest.raises(RuntimeError, match="the plant broke"):
        search_all(tmp_path, trials=1, run=broken, samplers=("random",))


def test_absent_optuna_is_named_before_anything_is_run(tmp_path, monkeypatch):
    there = analysis.importlib.util.find_spec
    monkeypatch.setattr(analysis.importlib.util, "find_spec", lambda name: None if name == "cmaes" else there(name))
    with pytest.raises(InputError, match=r"needs cmaes: pip install -e '\.\[analysis\]'"):
        analysis.main(analysis.parse(["falsify", "--out", str(tmp_path)]))


def test_scenario_gives_the_same_bits_back(tmp_path, draws):
    for seed, kind in ((0, "A"), (3, "B"), (4, "B"), (1, "none")):
        episode = draws.draw(seed, kind)
        save_scenario(tmp_path / "s.yaml", falsification.scenario_of(World(), episode, episode.disturbance))
        scenario = load_scenario(tmp_path / "s.yaml")
        scenario.check()
        if kind == "none":
            scenario.experimenter = Disturbance()
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
    with pytest.raises(InputError, match=named):
        Scenario(disturbance=kind, experimenter=Disturbance(**given)).check()


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
    scenario = Scenario(disturbance=kind, experimenter=Disturbance(level=0.1, **given))
    scenario.check()
    with pytest.raises(InputError, match=named):
        draws.episode(scenario)


def test_counterexample_replays_bit_by_bit(rollout, policy, world, draws, tmp_path, monkeypatch):
    """A push in the closed loop with fakes; its file, run as pick_place.py does."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 12.0)
    target = tuple(float(q) for q in world.initial_posture[:7] + np.deg2rad([10.0, 0, 0, -10.0, 0, 0, 0]) / 3)
    draw = Disturbance("A", 1, 0.18, target, 4)
    policy.learn(SCENE)
    outcome, record = rollout.run(replace(SCENE, disturbance=draw))
    trial = Trial.of(replace(PUSH, hold_ticks=4), draw, outcome, record, policy.gamma)
    assert trial.moved_deg > 1.0
    save_scenario(tmp_path / "s.yaml", falsification.scenario_of(world, SCENE, draw), ["a comment: with a colon"])
    assert (tmp_path / "s.yaml").read_text().startswith("# a comment: with a colon\n")
    episode = draws.episode(load_scenario(tmp_path / "s.yaml"))
    policy.learn(episode)
    _, record = rollout.run(episode)
    assert record_hash(record) == trial.digest
    undisturbed = replace(SCENE, disturbance=Disturbance())
    policy.learn(undisturbed)
    assert record_hash(rollout.run(undisturbed)[1]) != trial.digest


def test_a_blind_controller_is_defeated_and_the_program_replays_it(tmp_path, monkeypatch):
    """The shipped network with a threshold that nothing reaches: whatever keeps it from its task is a counterexample."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 7.0)  # too short for the task
    weights, out = tmp_path / "weights", tmp_path / "out"
    weights.mkdir()
    (weights / "cae.safetensors").symlink_to(WEIGHTS.resolve() / "cae.safetensors")
    save_policy(weights / "lstm.safetensors", replace(load_policy(WEIGHTS / "lstm.safetensors"), gamma=1e9))
    asked = ["--weights", str(weights), "--out", str(out), "--trials", "1", "--scenes", "1", "--workers", "1"]
    assert analysis.main(analysis.parse(["falsify", *asked])) == 0
    found = json.loads((out / "falsify.json").read_text())
    assert found["trials_to_first"] == {"tpe": 1, "cmaes": 1, "random": 1}
    assert len(found["counterexamples"]) == 3
    assert all(case["same_bits"] and case["same_failure"] for case in found["replayed"].values())
    assert (out / "falsify.png").read_bytes().startswith(PNG)
    case = found["counterexamples"][0]
    assert case["failure"] == "not detected"
    assert f"--scenario {case['file']} --weights DIR" in (out / case["file"]).read_text()
    log, summary = tmp_path / "run.npz", tmp_path / "run.json"
    asked = [
        "--scenario",
        str(out / case["file"]),
        "--weights",
        str(weights),
        "--log",
        str(log),
        "--json",
        str(summary),
    ]
    monkeypatch.chdir(tmp_path)
    assert pick_place.main(pick_place.parse(asked)) == 1
    assert record_hash(load_record(log)[0]) == case["record_hash"]
    assert json.loads(summary.read_text())["switch_success"] is False
