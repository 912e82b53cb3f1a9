"""The automaton of a run, on hand-made records."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from diagrams.hybrid.modes import mode_sequence, most_within, report
from tests.diagrams.episode_fakes import OUTCOME
from tests.diagrams.recorded_run import recorded_run

HOME = np.zeros(8)
FAILED = asdict(replace(OUTCOME, success=False, failure="stalled"))


def record_of(alpha):
    """A tick for each value of alpha."""
    n = len(alpha)
    return replace(recorded_run(n), alpha=np.array(alpha, float), hidden_state=np.full((n, 4), 0.5))


def sequence(alpha, name="run"):
    return mode_sequence(record_of(alpha), FAILED, name, HOME)


def test_stays_and_crossings_by_hand():
    run = sequence([0, 0, 0.4, 0.5, 1, 1, 0.6, 0.1, 0, 0.9])
    assert [(s.mode, s.complete) for s in run.modes] == [
        ("task", False), ("return", True), ("task", True), ("return", False),
    ]  # fmt: skip
    assert [s.start for s in run.modes] == pytest.approx([0.0, 0.3, 0.7, 0.9])
    assert run.modes[-1].end == pytest.approx(1.0)
    assert [s.seconds for s in run.modes] == pytest.approx([0.3, 0.4, 0.2, 0.1])
    assert run.crossings == pytest.approx([0.3, 0.7, 0.9])
    assert (run.max_crossings_per_second, run.shortest_stay) == (3, pytest.approx(0.2))
    assert run.outcome == "stalled"


def test_reset_compares_the_prediction_with_what_came():
    run = sequence([0, 1, 1, 0, 0])
    found, (reset,) = record_of([0, 1, 1, 0, 0]), run.resets
    # alpha_3 = 0: the network sees m_3 (Eqs. 7, 8); with alpha_3 = 1 it would have seen what it predicted at tick 2,
    # m^R_3 = m_2 + dm^R_2 + dm^L_2.
    jump = np.abs(found.posture[3] - (found.posture[2] + found.rnn_step[2] + found.regulator_step[2]))
    assert reset.time == pytest.approx(0.3)
    assert reset.joint_jump_deg == pytest.approx(np.rad2deg(jump[:7].max()))
    assert reset.finger_jump_m == pytest.approx(jump[7])
    assert reset.home_distance_deg == pytest.approx(np.rad2deg(np.abs(found.posture[3, :7]).max()))
    assert reset.state_rms == 0.5


def test_each_fall_of_alpha_is_a_reset():
    assert [reset.time for reset in sequence([0, 1, 1, 0, 0, 1, 0]).resets] == pytest.approx([0.3, 0.6])
    assert sequence([1, 1]).resets == []


def test_run_in_one_mode_has_no_crossing():
    run = sequence([0] * 5)
    assert (run.crossings, run.resets, run.max_crossings_per_second) == ([], [], 0)
    assert run.shortest_stay == float("inf")
    assert [s.seconds for s in run.modes] == pytest.approx([0.5])


@pytest.mark.parametrize(
    ("times", "most"),
    [([], 0), ([3.0], 1), ([0.0, 1.0, 2.0], 1), ([0.0, 0.9, 1.0], 2), ([0.1 * k for k in range(30)], 10)],
)
def test_most_crossings_in_a_second(times, most):
    assert most_within(times, 1.0) == most


def test_report_counts_and_names_the_chatter():
    calm, chatter = sequence([0, 0, 1, 1, 0, 0], "calm"), sequence([0, 1] * 6, "chatter")
    found = report([calm, chatter], limit=4)
    assert (found["runs"], found["max_crossings_per_second"], found["zeno_like"]) == (2, 10, ["chatter"])
    assert found["nearest"][0]["name"] == "chatter"
    assert found["transitions"] == {"task->return": 1 + 6, "return->task": 1 + 5}
    assert found["dwell_seconds"]["return"]["count"] == 1 + 5
    assert found["dwell_seconds"]["return"]["max"] == pytest.approx(0.2)
    assert found["dwell_seconds"]["task"]["count"] == 5
    assert found["final_modes"] == {"task": 1, "return": 1}
    assert found["sequences"][0]["modes"][1] == {"mode": "return", "start": 0.2, "end": 0.4, "complete": True}
    json.dumps(found["sequences"], allow_nan=False)
