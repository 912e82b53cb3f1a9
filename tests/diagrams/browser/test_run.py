"""Run: what the server's loop is given, and which file a scene is written to; with a scene made by hand."""

import time
from collections import deque
from types import SimpleNamespace

import pytest

from diagrams.browser.run import LEAST_WAIT, LONGEST_WAIT, SLICE, Run
from diagrams.world.hands_schedule import HandsSchedule
from models.errors import InputError


class FakeSession:
    """Its ticks take `length` s."""

    period = 0.1

    def __init__(self, length=0.0):
        self.length, self.scene, self.ticks, self.ended, self.rows, self.mode, self.since = length, 1, 0, "", [], "", 0
        self.hands, self.events, self.files, self.refused = HandsSchedule(), deque(), {}, False

    @property
    def seconds(self):
        return self.ticks * self.period

    def tick(self):
        self.ticks += 1
        time.sleep(self.length)

    def require_going(self):
        if self.ended.startswith("diverged"):
            raise InputError(self.ended)

    def pull(self, force):
        self.hands.force.append([float(self.ticks), force, 0.0, 0.0])

    def recorded(self):
        return SimpleNamespace(hands=HandsSchedule(force=list(self.hands.force)))

    def save(self, path):
        if self.refused:
            raise InputError(f"{path} cannot be written")
        self.files[path.name] = self.recorded().hands.force

    def next_scene(self):
        self.scene, self.ticks, self.hands, self.ended = self.scene + 1, 0, HandsSchedule(), ""
        self.events.clear()

    def choose(self, **_):
        self.next_scene()


@pytest.fixture
def session():
    return FakeSession()


@pytest.fixture
def run(session, tmp_path):
    return Run(session, 1.0, tmp_path / "live.yaml")


@pytest.mark.parametrize("speed", [0.0, 1.0, 5.0, 0.05])
@pytest.mark.parametrize("length", [0.0, 0.12])
def test_the_pages_have_their_turn_after_each_slice_and_no_wait_is_long(speed, length, tmp_path):
    session = FakeSession(length)
    run = Run(session, speed, tmp_path / "live.yaml")
    for _ in range(3):
        began = time.monotonic()
        assert 0.005 <= LEAST_WAIT <= run.work() <= LONGEST_WAIT <= 0.05
        assert session.ticks
        if length > SLICE:
            assert time.monotonic() - began < 2 * length + 0.1  # one tick, or none
    run.pause(True)
    done = session.ticks
    assert LEAST_WAIT <= run.work() <= LONGEST_WAIT
    assert session.ticks == done


def test_a_slow_speed_is_left_at_once(session, tmp_path):
    run = Run(session, 0.05, tmp_path / "live.yaml")
    run.work()
    run.set_speed(0.0)
    run.work()
    assert session.ticks > 1


def test_each_scene_has_a_file_of_its_own(session, run):
    session.pull(1.0)
    assert run.save().name == "live.yaml"
    session.tick()
    session.pull(2.0)
    assert run.save().name == "live.yaml"
    run.next_scene()
    run.next_scene()  # nobody did anything in it
    session.pull(3.0)
    run.choose(seed=5)
    assert [what.endswith("live-2.yaml") for _, what in session.events] == [True]
    session.pull(4.0)
    assert run.keep().name == "live-3.yaml"
    assert run.keep() is None
    assert {name: [row[1] for row in rows] for name, rows in session.files.items()} == {
        "live.yaml": [1.0, 2.0], "live-2.yaml": [3.0], "live-3.yaml": [4.0],
    }  # fmt: skip


def test_a_scene_that_cannot_be_written_is_left_with_words(session, run):
    session.pull(1.0)
    session.refused = True
    with pytest.raises(InputError, match="cannot be written"):
        run.next_scene()
    assert session.scene == 2
    session.refused = False
    session.pull(2.0)
    assert run.keep().name == "live.yaml"


def test_what_diverged_does_not_go_on(session, run):
    session.ended = "diverged: begin another scene"
    run.pause(True)
    with pytest.raises(InputError, match="begin another"):
        run.pause(False)
    assert run.paused
    assert "begin another" in run.words()
    run.next_scene()
    assert not run.paused


def test_behind_what(tmp_path):
    """At another speed nothing of the last is said."""
    run = Run(FakeSession(0.0), 1.0, tmp_path / "live.yaml")
    for k in range(20):
        run.pace.ran(k, k + 0.5)
    assert "behind real time: 100 %" in run.words()
    run.set_speed(5.0)
    assert run.words().endswith("in the scene, 5 times real time")
    for k in range(20):
        run.pace.ran(k, k + 0.5)
    assert "behind 5 times real time: 100 %" in run.words()
    assert "20 of 20 ticks late at real time (100.0 %)" in run.pace.words()
