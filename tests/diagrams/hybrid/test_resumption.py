"""The region of resumption: the report by hand, V against the whole system, and the program."""

import json

import numpy as np
import pytest

from diagrams import analysis
from diagrams.episodes.calibration import Controller
from diagrams.episodes.runner import Job
from diagrams.hybrid.resumption import Resume, ResumeJob, judge, run_job
from diagrams.hybrid.resumption_starts import Memory
from diagrams.hybrid.resumption_time import time_to_resume
from diagrams.world.configuration import World
from diagrams.world.names import ENCODER, WEIGHTS
from models.data.scaling import MinMaxScaling
from tests.diagrams.untrained import save_untrained

HORIZON = 2


def test_judge_by_hand():
    """Of five starts one failed that was foretold to take 40 ticks, and one that was foretold to fail did not."""
    rows = [(1, 1.0, 10, 12, True), (1, 2.0, 30, 29, False), (1, 1.0, 40, None, None), (1, 1.0, 70, 60, None),
            (1, 1.0, None, 100, None)]  # fmt: skip
    found = judge(rows, 0.1)
    assert (found["samples"], found["not_resumed"], found["foretold"], found["foretold_wrongly"]) == (5, 2, 2, 2)
    assert found["largest_error_ticks"] == 10
    assert (found["level_ticks"], found["inside"]) == (30, 2)
    assert found["inside_bound"] == pytest.approx(1.0 - 0.05**0.5)
    assert found["time_s"]["max"] == pytest.approx(6.0)
    assert found["time_s"]["median"] == pytest.approx(2.9)
    assert found["finished"]["samples"] == 2
    assert found["finished"]["failures"] == 1
    json.dumps(found)


def test_judge_of_starts_that_all_fail():
    found = judge([(1, 1.0, 5, None, None)] * 3, 0.1)
    assert (found["level_ticks"], found["inside"], found["inside_bound"]) == (None, 0, 1.0)
    assert found["time_s"] is None
    assert found["finished"] is None


class Imagining:
    """Its hidden state counts down; what it predicts and recalls is off by 1 in every joint until it is 0."""

    posture_size, horizon, beta, gamma = 8, HORIZON, 30.0, 4.0
    scaling = MinMaxScaling(-np.ones(8), np.ones(8))
    initial_posture, mean_errors = np.zeros(8), [1e-2] * (HORIZON + 1)

    def step(self, x, state):
        left = state - 1.0
        posture = np.full(8, 1.0 if left[0] > 0 else 0.0)
        return np.append(posture, 0.0), left, np.tile(posture, (HORIZON, 1))

    def memory(self, ticks):
        return Memory(np.array([float(ticks + 1)]), np.zeros(9), np.zeros((HORIZON, 8))).imagined(self)


@pytest.mark.parametrize("ticks", [0, 1, 7])
def test_v_by_hand_is_what_the_network_has_left_to_imagine(ticks):
    policy = Imagining()
    at_home = np.zeros((HORIZON + 1, 7))
    assert time_to_resume(policy, policy.memory(ticks), at_home, 0.1, 20, reset=False) == ticks
    assert time_to_resume(policy, policy.memory(ticks), at_home, 0.1, 20, reset=True) == min(ticks, 1)


def test_v_is_none_beyond_the_limit():
    policy = Imagining()
    assert time_to_resume(policy, policy.memory(9), np.zeros((HORIZON + 1, 7)), 0.1, 8, reset=False) is None


def test_v_by_hand_of_an_arm_on_its_way():
    """All joints off by 0.5, the error allowed is 0.2 (4 mean errors of 0.01): the slowest criterion is n = 2."""
    policy = Imagining()
    rows = np.tile(0.5 / 0.9 ** np.arange(HORIZON + 1)[:, None], (1, 7))
    found = time_to_resume(policy, policy.memory(0), rows, 0.1, 60, reset=True)
    needed = int(np.ceil(np.log(0.2 / 0.5) / np.log(0.9)))  # ticks until the joints are within 0.2
    assert found == needed + HORIZON + 1  # and until the oldest that is judged, m_{k-1-2}, is


def test_falls_by_one_a_tick():
    """V is a Lyapunov function: one tick later one tick less is left."""
    policy, home = Imagining(), np.zeros((HORIZON + 1, 7))
    memory = policy.memory(9)
    for left in range(9, -1, -1):
        assert time_to_resume(policy, memory, home, 0.1, 20, reset=False) == left
        memory = memory.imagined(policy)


def job(rule, seed=5_000_000):
    world = World(resumption=rule)
    return ResumeJob(Job(world, WEIGHTS / ENCODER, Controller(WEIGHTS / "lstm.onnx"), seed), rule, 0, 0)


def test_real_starts_resume_as_foretold_with_the_can_in_the_hand(monkeypatch):
    monkeypatch.setattr("diagrams.hybrid.resumption.STARTS_A_SCENE", 4)
    rows = run_job(job("reset"))
    assert [row[0] for row in rows] == [1] * 4 + [2] * 4
    for _, _, foretold, measured, _ in rows:
        assert foretold is not None
        assert measured is not None
        assert measured <= 60
        assert abs(measured - foretold) <= 4
    assert rows == run_job(job("reset"))


def test_program(tmp_path, monkeypatch):
    """On a network whose recall always fails: nothing resumes, and the exit code says so; a second run goes on."""
    calls = []

    def fake(given):
        calls.append(given.key)
        return [(s, 1.0, None, None, None) for s in (1, 2) for _ in range(30)]

    monkeypatch.setattr("diagrams.hybrid.resumption.run_job", fake)
    weights = save_untrained(tmp_path)
    asked = ["resume", "--weights", str(weights), "--starts", "20", "--finished", "0", "--workers", "0"]
    assert analysis.main(analysis.parse([*asked, "--out", str(tmp_path / "out")])) == 1
    found = json.loads((tmp_path / "out" / "resume.json").read_text())
    assert found["rule"] == "reset"
    assert found["rules"]["imagined"]["2"]["samples"] == 20
    assert found["rules"]["reset"]["1"]["not_resumed"] == 20
    assert len(calls) == 2
    assert (tmp_path / "out" / "resume.png").is_file()
    assert not list((tmp_path / "out").glob("*.jsonl"))


def test_a_number_that_is_too_small_is_named(tmp_path):
    with pytest.raises(Exception, match="--starts 0 is too small: choose 1 or more"):
        Resume(out=tmp_path, starts=0).check()
