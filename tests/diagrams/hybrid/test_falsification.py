"""Falsification: its report, and scenario files that replay bit by bit."""

import json
import sys
from dataclasses import replace
from functools import partialmethod

import numpy as np
import pytest

from diagrams import analysis, pick_place
from diagrams.episodes.episode import Episode
from diagrams.episodes.record import load_record, record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.hybrid import falsification
from diagrams.hybrid.falsification import scenario_of
from diagrams.hybrid.perturbations import Perturbation
from diagrams.hybrid.search import Trial
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import load_scenario, save_scenario
from models.files.weights import load_policy, save_policy

SCENE = Episode(5, (0.555, -0.041), "left")


def trial(size, failure=None, switch_failure=None, done=True):
    perturbation = Perturbation(0, DisturbanceSpec("A", 0.1, [0.0] * 7, 25), size)
    return Trial(perturbation, failure, switch_failure or failure, done, 1.0, size, f"hash {size}")


def test_report_by_hand():
    lost = {"failure": "not returned", "done": False}
    tpe = [trial(10.0), trial(40.0, **lost), trial(20.0, **lost), trial(5.0, None, "not detected")]
    found = falsification.report({"tpe": tpe, "random": [trial(30.0, **lost)], "cmaes": []}, [SCENE])
    assert [case["file"] for case in found["counterexamples"]] == ["tpe-3.yaml", "random-1.yaml", "tpe-2.yaml"]
    assert found["counterexamples"][0]["record_hash"] == "hash 20.0"
    assert found["counterexamples"][0]["magnitude"] == pytest.approx(0.5 * 20 / 60 + 0.5)
    assert found["trials"] == {"tpe": 4, "random": 1, "cmaes": 0}
    assert found["trials_to_first"] == {"tpe": 2, "random": 1, "cmaes": None}
    assert found["smallest_magnitude"]["cmaes"] is None
    assert found["failures"]["tpe"] == {"not detected": 0, "not returned": 2, "not resumed": 0, "switched again": 0}
    json.dumps(found, allow_nan=False)
    assert falsification.words("cmaes", found) == "cmaes: no counterexample in 0 trials"
    told = "tpe: first counterexample after 2 of 4 trials, smallest magnitude 0.667; 2 not returned"
    assert falsification.words("tpe", found) == told


def test_absent_optuna_is_named_before_anything_is_run(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(ModuleNotFoundError, match="cmaes"):
        analysis.main(analysis.parse(["falsify", "--out", str(tmp_path)]))


@pytest.mark.parametrize(("seed", "kind"), [(0, "A"), (3, "B"), (4, "B"), (1, "none")])
def test_scenario_gives_the_same_bits_back(tmp_path, world, sampler, seed, kind):
    episode = sampler.sample(seed, kind)
    save_scenario(tmp_path / "s.yaml", scenario_of(world, episode, "lstm", episode.disturbance))
    scenario = load_scenario(tmp_path / "s.yaml")
    scenario.check()
    # Of a disturbance that is given it isn't known whether the way home is clear.
    assert sampler.episode(scenario) == (episode if kind == "none" else replace(episode, way_home_clear=None))


def test_counterexample_replays_bit_by_bit(rollout, policy, world, sampler, tmp_path):
    """A perturbation in the closed loop with fakes; its file, run as pick_place.py does."""
    target = (world.initial_posture[:7] + np.deg2rad([10.0, 0, 0, -10.0, 0, 0, 0]) / 3).tolist()
    disturbance = DisturbanceSpec("A", 0.18, target, 4)
    policy.learn(SCENE)
    outcome, record = rollout.run(replace(SCENE, disturbance=disturbance), time_limit=12.0)
    found = Trial.of(Perturbation(0, disturbance, 5.0), outcome, record, policy.gamma)
    assert found.moved_deg > 1.0
    save_scenario(tmp_path / "s.yaml", scenario_of(world, SCENE, "lstm", disturbance), ["a comment: with a colon"])
    assert (tmp_path / "s.yaml").read_text().startswith("# a comment: with a colon\n")
    episode = sampler.episode(load_scenario(tmp_path / "s.yaml"))
    policy.learn(episode)
    assert record_hash(rollout.run(episode, time_limit=12.0)[1]) == found.record_hash
    policy.learn(SCENE)
    assert record_hash(rollout.run(SCENE, time_limit=12.0)[1]) != found.record_hash


def test_a_blind_controller_is_defeated_and_the_program_replays_it(tmp_path, monkeypatch):
    """The shipped network with a threshold that nothing reaches: whatever stops it is a counterexample."""
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=7.0))  # too short for the task
    weights, out = tmp_path / "weights", tmp_path / "out"
    weights.mkdir()
    (weights / "encoder.onnx").symlink_to(WEIGHTS.resolve() / "encoder.onnx")
    save_policy(weights / "lstm.onnx", replace(load_policy(WEIGHTS / "lstm.onnx"), gamma=1e9))
    asked = ["--weights", str(weights), "--out", str(out), "--trials", "1", "--scenes", "1", "--workers", "0"]
    assert analysis.main(analysis.parse(["falsify", *asked])) == 0
    found = json.loads((out / "falsify.json").read_text())
    assert found["trials_to_first"] == {"tpe": 1, "cmaes": 1, "random": 1}
    assert len(found["counterexamples"]) == 3
    assert all(case["same_bits"] and case["same_failure"] for case in found["replayed"].values())
    assert (out / "falsify.png").is_file()
    case = found["counterexamples"][0]
    assert case["failure"] == "not detected"
    assert f"--scenario {case['file']} --weights DIR" in (out / case["file"]).read_text()
    record, summary = tmp_path / "run.npz", tmp_path / "run.json"
    asked = ["--scenario", str(out / case["file"]), "--weights", str(weights), "--record", str(record)]
    monkeypatch.chdir(tmp_path)
    assert pick_place.main(pick_place.parse([*asked, "--json", str(summary)])) == 1
    assert record_hash(load_record(record)[0]) == case["record_hash"]
    assert json.loads(summary.read_text())["switch_success"] is False
