"""The automaton of a run, on hand-made records; records on disk."""

import json

import numpy as np
import pytest

from diagrams.episodes import pool as workers
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.calibration import Controller
from diagrams.episodes.pool import Job
from diagrams.episodes.record import Record, find_records, load_record, record_hash, save_record
from diagrams.hybrid.modes import mode_sequence, most_within, report, save_automaton, short_stays
from diagrams.world.configuration import World
from models.errors import InputError
from systems.loop_closer import LoopCloser
from tests.diagrams.untrained import save_untrained

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
        active=np.zeros(n, bool), can_poses=np.zeros((n, 14)),
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
    # alpha_3 = 0: the network sees m_4 (Eqs. 7, 8 with alpha_3), where with alpha_3 = 1 it would have seen what it predicted at tick 3.
    jump = np.abs(found.posture[4] - (found.posture[3] + found.rnn_step[3]))
    assert reset.time == pytest.approx(0.4)
    assert reset.joint_jump_deg == pytest.approx(np.rad2deg(jump[:7].max()))
    assert reset.finger_jump_m == pytest.approx(jump[7])
    assert reset.home_distance_deg == pytest.approx(np.rad2deg(np.abs(found.posture[4, :7]).max()))
    assert reset.state_rms == 0.5


def test_a_reset_at_the_last_tick_is_none_yet():
    assert sequence([0, 1, 1, 0]).resets == []


def test_reset_of_the_loop_itself():
    """What LoopCloser gives to the network at that tick, in mode task and had alpha stayed: their difference is the jump."""
    closer = LoopCloser(posture_size=2, feature_size=1)
    context = closer.CreateDefaultContext()
    measured, imagined = np.array([0.3, -0.2]), np.array([0.5, 0.1])
    inputs = {}
    for alpha in (0.0, 1.0):
        for name, value in (
            ("posture", measured), ("features", [0.0]), ("predicted_posture", imagined), ("predicted_features", [0.0]),
            ("alpha", [alpha]),
        ):  # fmt: skip
            closer.GetInputPort(name).FixValue(context, np.asarray(value))
        inputs[alpha] = closer.get_output_port().Eval(context)[:2].copy()
    assert inputs[0.0] - inputs[1.0] == pytest.approx(measured - imagined)


def test_short_stays_by_where_they_come():
    at_onset = [0] * 10 + [1, 0] + [1] * 30 + [0] * 9
    at_reset = [0] * 10 + [1] * 30 + [0, 1, 0, 0] + [0] * 9
    between = [0] * 10 + [1] * 30 + [0] * 2 + [1] * 30 + [0] * 9
    assert short_stays([sequence(at_onset)]) == {"onset": 2, "reset": 0, "between": 0}
    assert short_stays([sequence(at_reset)]) == {"onset": 0, "reset": 2, "between": 0}
    assert short_stays([sequence(between)]) == {"onset": 0, "reset": 0, "between": 1}
    assert short_stays([sequence([0] * 5), sequence([0, 1])]) == {"onset": 0, "reset": 0, "between": 0}


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
    assert record_hash(after) == record_hash(before)
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
    assert record_hash(one) != record_hash(other)


def test_what_is_no_record_is_named(tmp_path):
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "other.npz", a=1)
    (tmp_path / "nothing.npz").write_bytes(b"")
    save_record(tmp_path / "whole.npz", record([0, 1, 0]), FakeOutcome())
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "flipped.npz").write_bytes(whole[:400] + bytes(200) + whole[600:])
    np.save(tmp_path / "array.npz.npy", np.zeros(3))
    (tmp_path / "array.npz.npy").rename(tmp_path / "array.npz")
    broken = ("text.npz", "other.npz", "nothing.npz", "cut.npz", "flipped.npz", "array.npz")
    for name, words in (("none.npz", "no record"), *((name, "holds no record") for name in broken)):
        with pytest.raises(InputError, match=words) as caught:
            load_record(tmp_path / name)
        assert "\n" not in str(caught.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="in the folder"):
        find_records([tmp_path / "empty"])
