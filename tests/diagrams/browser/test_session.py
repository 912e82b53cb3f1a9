"""Session: what is played is recorded, and replayed to the same bits; it runs on in bounded memory."""

import numpy as np
import pytest

from diagrams import pick_place
from diagrams.browser.page import COLUMNS
from diagrams.browser.run import Run
from diagrams.browser.session import KEPT_EVENTS, KEPT_ROWS, RETURN, TASK, Session
from diagrams.episodes.record import load_record
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import ARM_JOINTS, WEIGHTS
from diagrams.world.scenario import Scenario
from models.errors import InputError

UNDISTURBED = Scenario(disturbance=DisturbanceSpec())


@pytest.fixture(scope="module")
def session():
    return Session(UNDISTURBED, WEIGHTS)


def ticks(session, count):
    for _ in range(count):
        session.tick()


def test_what_is_played_is_replayed_to_the_same_bits_by_pick_place(session, tmp_path, monkeypatch):
    session.choose(seed=3)
    ticks(session, 25)
    session.hold("one page", True)
    ticks(session, 4)
    session.hold("another", True)
    session.hold("one page", False)
    ticks(session, 4)
    assert session.mode == RETURN
    session.hold("another", False)
    session.pull(np.array([0.0, 7.5, 1 / 3]))
    session.fault("frozen")
    ticks(session, 5)
    session.set_gamma(33.3)
    session.put_can(0.5, 0.04)
    session.move()
    ticks(session, 20)
    session.fault("clear")
    ticks(session, 2)
    path = tmp_path / "played.yaml"
    session.save(path)
    played = [(row["alpha"], *(row[f"m{j}"] for j in range(1, ARM_JOINTS + 1))) for row in session.rows]
    assert session.ticks == 60
    assert sum(row["active"] for row in session.rows) == 8 + 18

    monkeypatch.chdir(tmp_path)
    cli = pick_place.parse(["--scenario", str(path), "--record", "run.npz"])
    assert cli.seed == 3
    pick_place.main(cli)
    record, _ = load_record(tmp_path / "run.npz")
    assert len(record.time) > 60
    again = np.column_stack([record.alpha, np.rad2deg(record.posture[:, :ARM_JOINTS])])[:60]
    assert again.tobytes() == np.array(played).tobytes()
    assert [what for _, what in record.events].count("the experimenter disturbs the arm") == 2


def test_the_plots_are_fed_with_what_they_say(session):
    """On the learned way what is imagined for a tick, and recalled of it a second later, is near to what was."""
    session.choose(seed=4)
    ticks(session, 30)
    rows = list(session.rows)
    assert [row["time"] for row in rows] == pytest.approx(np.arange(30) * 0.1)
    joints = {letter: np.array([[row[f"{letter}{j}"] for j in range(1, 8)] for row in rows]) for letter in "mir"}
    assert [row["imagined_time"] for row in rows][:2] == pytest.approx([0.1, 0.2])
    assert rows[29]["recalled_time"] == pytest.approx(1.9)
    assert np.abs(joints["i"][9:-1] - joints["m"][10:]).max() < 1.5
    assert np.abs(joints["r"][29] - joints["m"][19]).max() < 4.0
    assert np.abs(joints["m"][29] - joints["m"][19]).max() > 4.0
    assert session.mode == TASK
    seen, told = session.pictures()
    assert seen.shape == told.shape == (112, 112, 3)
    assert np.abs(seen.astype(float) - told).mean() < 30.0


def test_a_covered_camera_is_black_in_the_page_and_in_the_features(session):
    session.choose(seed=4)
    ticks(session, 2)
    bright = session.pictures()[1].mean()
    session.fault("covered")
    ticks(session, 1)
    seen, told = session.pictures()
    assert not seen.any()
    assert abs(told.mean() - bright) > 5.0


def test_memory_is_bounded(session):
    """More ticks and more events than are kept; what is kept is the newest."""
    session.choose(seed=5)
    for k in range(KEPT_ROWS + 5):
        session.hold("page", k % 2 == 0)
        session.tick()
    session.hold("page", False)
    assert [row["time"] for row in session.rows] == pytest.approx(0.1 * np.arange(5, KEPT_ROWS + 5))
    assert len(session.events) == KEPT_EVENTS
    assert session.events[-1][0] == pytest.approx(0.1 * (KEPT_ROWS + 4))
    root = session.rollout.simulator.get_context()
    assert [log.FindLog(root).num_samples() for log in session.rollout.log.sinks] == [0, 0]
    assert not session._narrator.events


def test_a_move_under_a_hand_that_holds_leaves_the_arm_held(session):
    session.choose(seed=3)
    session.hold("page", True)
    ticks(session, 2)
    session.move()
    ticks(session, 25)
    assert all(row["active"] for row in session.rows)
    session.move()
    ticks(session, 3)
    session.hold("page", False)
    ticks(session, 14)
    assert session.rows[-1]["active"]
    ticks(session, 3)
    assert not session.rows[-1]["active"]


def test_what_diverged_is_refused_with_words(session, monkeypatch):
    session.choose(seed=3)
    ticks(session, 1)
    with monkeypatch.context() as patch:
        patch.setattr(session.rollout, "advance", lambda _: False)
        session.tick()
    assert (session.ticks, session.diverged) == (1, True)
    for act in (session.tick, session.move, session.pictures, session.can_xy, session.require_going):
        with pytest.raises(InputError, match="the simulation diverged: begin another scene"):
            act()
    session.leave("a page that goes")
    session.choose(seed=3)
    ticks(session, 1)


def test_the_can_that_is_put_is_told_and_what_cannot_be_written_is_refused(session, tmp_path):
    session.choose(seed=3)
    ticks(session, 2)
    session.put_can(0.5, 0.04)
    ticks(session, 2)
    assert [event for event in session.events if "can is" in event[1]] == [(0.2, "the can is moved on the desk")]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"played\.yaml cannot be written"):
        session.save(tmp_path / "file" / "played.yaml")


def test_a_tick_after_the_task_is_done_waits_for_somebody(session, tmp_path):
    session.choose(seed=0)
    run = Run(session, 0.0, tmp_path / "played.yaml")
    for _ in range(2000):
        run.work()
        if run.paused:
            break
    assert "task done" in run.words()
    assert session.events[-1][1] == "task done"
    done = session.ticks
    run.work()
    assert session.ticks == done
    run.pause(False)
    run.work()
    assert session.ticks > done
    run.pause(True)
    run.single()
    run.next_scene()
    assert (session.scenario.seed, session.ticks, run.paused) == (1, 0, False)


@pytest.mark.parametrize(
    ("act", "named"),
    [
        (lambda session: session.put_can(0.9, 0.0), r"\(0.900, 0.000\) m is out of reach"),
        (lambda session: session.set_gamma(0.0), "gamma 0.0 is outside"),
        (lambda session: session.choose(seed=-1), "seed -1 is negative"),
        (lambda session: session.choose(rnn="perceptron"), "no network 'perceptron'"),
        (lambda session: session.pull(np.array([61.0, 0.0, 0.0])), "too large"),
    ],
)
def test_bad_input_leaves_the_scene_as_it_is(session, act, named):
    session.choose(seed=6)
    ticks(session, 3)
    with pytest.raises(InputError, match=named):
        act(session)
    ticks(session, 1)
    assert (session.ticks, session.scenario.seed) == (4, 6)
    assert not session.recorded().hands


def test_another_network_and_detector(session):
    session.choose(seed=6, rnn="gru")
    ticks(session, 3)
    assert session.rollout.policy.name == "gru"
    with pytest.raises(InputError, match="no calibration for the policy"):
        session.choose(detector="knn")
    ticks(session, 1)
    assert (session.ticks, session.recorded().rnn) == (4, "gru")
    session.choose(seed=6, rnn="lstm", detector="knn")
    ticks(session, 1)
    assert len(session.rows[-1]) == len(COLUMNS)
    session.choose(seed=6, rnn="lstm", detector="recall")
