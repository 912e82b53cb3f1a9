"""The automaton of a run, on hand-made records; records on disk."""

import json

import numpy as np
import pytest
from untrained import save_untrained

from diagrams import rollout as rollout_module
from diagrams import workers
from diagrams.controllers import Controller
from diagrams.hybrid_modes import mode_sequence, most_within, report, save_automaton
from diagrams.records import digest, find_records, load_record, save_record
from diagrams.rollout import Record
from diagrams.scenario import ScenarioError, World
from diagrams.workers import Job

PNG = b"\x89PNG\r\n\x1a\n"
HOME = np.zeros(8)


class FakeOutcome:
    """Just the fields that are read."""

    def to_dict(self):
        return {"success": False, "failure": "stalled", "disturbance": "A"}


def record(alpha):
    n = len(alpha)
    rng = np.random.default_rng(0)
    return Record(
        time=0.1 * np.arange(n), posture=rng.normal(size=(n, 8)), rnn_step=rng.normal(size=(n, 8)),
        regulator_step=np.zeros((n, 8)), desired_posture=np.zeros((n, 8)), alpha=np.array(alpha, float),
        errors=np.ones((n, 11)), hidden_state=np.full((n, 4), 0.5), features=np.zeros((n, 3)),
        active=np.zeros(n, bool), can_poses=np.zeros((n, 14)), squared_errors=np.zeros((n, 11)),
        events=[(0.1, "something")],
    )  # fmt: skip


def sequence(alpha, name="run"):
    return mode_sequence(record(alpha), FakeOutcome().to_dict(), name, HOME)


def test_stays_and_crossings_by_hand():
    run = sequence([0, 0, 0.4, 0.5, 1, 1, 0.6, 0.1, 0, 0.9])
    assert [(s.mode, s.complete) for s in run.stays] == [
        ("task", False), ("return", True), ("task", True), ("return", False),
    ]  # fmt: skip
    assert [s.start for s in run.stays] == pytest.approx([0.0, 0.3, 0.7, 0.9])
    assert run.stays[-1].end == pytest.approx(1.0)
    assert [s.seconds for s in run.stays] == pytest.approx([0.3, 0.4, 0.2, 0.1])
    assert [(c.tick, c.source, c.target) for c in run.crossings] == [
        (3, "task", "return"), (7, "return", "task"), (9, "task", "return"),
    ]  # fmt: skip
    assert (run.crossings[0].alpha_before, run.crossings[0].alpha_after) == (0.4, 0.5)
    assert (run.max_crossings_per_second, run.shortest_stay) == (3, pytest.approx(0.2))
    assert run.outcome == "stalled"


def test_reset_compares_the_prediction_with_what_came():
    run = sequence([0, 1, 1, 0, 0])
    found, (reset,) = record([0, 1, 1, 0, 0]), run.resets
    jump = np.abs(found.posture[3] - (found.posture[2] + found.rnn_step[2]))
    assert reset.time == pytest.approx(0.3)
    assert reset.joint_jump_deg == pytest.approx(np.rad2deg(jump[:7].max()))
    assert reset.finger_jump_m == pytest.approx(jump[7])
    assert reset.home_distance_deg == pytest.approx(np.rad2deg(np.abs(found.posture[3, :7]).max()))
    assert reset.state_rms == 0.5


def test_run_in_one_mode_has_no_crossing():
    run = sequence([0] * 5)
    assert (run.crossings, run.resets, run.max_crossings_per_second) == ([], [], 0)
    assert run.shortest_stay == float("inf")
    assert [s.seconds for s in run.stays] == pytest.approx([0.5])


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
    assert found["cut_off_seconds"]["task"]["count"] == 3
    assert found["final_modes"] == {"task": 1, "return": 1}
    json.dumps(found, allow_nan=False)


def test_automaton_is_drawn(tmp_path):
    save_automaton([sequence([0, 1, 1, 0]), sequence([0, 0])], tmp_path / "new" / "modes.png")
    assert (tmp_path / "new" / "modes.png").read_bytes().startswith(PNG)


def test_record_survives_the_disk(tmp_path):
    before = record([0, 1, 0])
    save_record(tmp_path / "new" / "run.npz", before, FakeOutcome())
    after, outcome = load_record(tmp_path / "new" / "run.npz")
    assert digest(after) == digest(before)
    assert after.events == before.events
    assert outcome == FakeOutcome().to_dict()
    assert find_records([tmp_path / "new", tmp_path / "x.npz"]) == [tmp_path / "new" / "run.npz", tmp_path / "x.npz"]


def test_a_worker_leaves_the_record(tmp_path, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 0.5)
    folder = save_untrained(tmp_path / "weights")
    worker = workers.Worker(World(), folder / "cae.safetensors")
    found, _ = worker.run(Job(5, "none", log=tmp_path / "logs" / "5.npz"), Controller(folder / "lstm.safetensors"))
    written, outcome = load_record(tmp_path / "logs" / "5.npz")
    assert len(written.time) == 5
    assert outcome["seed"] == found.seed == 5


def test_digest_sees_one_bit():
    one, other = record([0, 1, 0]), record([0, 1, 0])
    other.posture[1, 3] = np.nextafter(other.posture[1, 3], 9)
    assert digest(one) != digest(other)


def test_what_is_no_record_is_named(tmp_path):
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "other.npz", a=1)
    for name, words in (("none.npz", "no record"), ("text.npz", "holds no record"), ("other.npz", "holds no record")):
        with pytest.raises(ScenarioError, match=words) as caught:
            load_record(tmp_path / name)
        assert "\n" not in str(caught.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ScenarioError, match="in the folder"):
        find_records([tmp_path / "empty"])
