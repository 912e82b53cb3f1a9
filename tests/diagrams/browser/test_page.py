"""The page without a browser: widgets follow the session, and what is done in a page that goes ends with it."""

import os
import signal
import socket
import threading
import time
from types import SimpleNamespace

import pytest
from bokeh.client import pull_session
from bokeh.document import Document
from bokeh.events import ButtonClick

from diagrams.browser.page import HOLDING, Page
from diagrams.browser.run import Run
from diagrams.browser.server import serve
from diagrams.browser.session import Session
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import Scenario


@pytest.fixture(scope="module")
def session():
    return Session(Scenario(disturbance=DisturbanceSpec()), WEIGHTS)


@pytest.fixture
def run(session, tmp_path):
    session.choose(seed=3, rnn="lstm")
    session.tick()
    return Run(session, 3.0, tmp_path / "live.yaml")


class Visitor:
    """A page, and the widgets in it by their names."""

    def __init__(self, run, name):
        self.document, self.server = Document(), SimpleNamespace(connection_count=1)
        context = SimpleNamespace(id=name, session=self.server)
        self.document._session_context = lambda: context
        self.page = Page(self.document, run, "about:blank")

    def __getitem__(self, name):
        return self.document.get_model_by_name(name)

    def click(self, name):
        self.document.callbacks.trigger_event(ButtonClick(self[name]))

    def update(self):
        self.page._update()


@pytest.fixture
def two(run):
    return Visitor(run, "one"), Visitor(run, "two")


def test_a_pull_is_let_go_in_any_page_and_ends_with_its_own(session, two):
    one, other = two
    one["pull_x"].value = 20
    one["pull_z"].value = -5
    other.update()
    assert session.force.tolist() == [20.0, 0.0, -5.0]
    assert [other[f"pull_{axis}"].value for axis in "xyz"] == [20, 0, -5]
    other.click("let_go")
    one.update()
    assert session.force.tolist() == [0.0] * 3
    assert [one[f"pull_{axis}"].value for axis in "xyz"] == [0] * 3
    session.tick()
    one["pull_y"].value = 7
    other.server.connection_count = 0
    other.update()
    assert session.force.tolist() == [0.0, 7.0, 0.0]
    one.server.connection_count = 0
    one.update()
    assert session.force.tolist() == [0.0] * 3


def test_widgets_show_what_runs_whoever_changed_it(session, run, two):
    one, other = two
    assert [each["speed"].value for each in two] == ["3 times"] * 2
    one["speed"].value = "half"
    one["camera"].active = 1
    one["gamma"].value = "33"
    other.update()
    assert (run.pace.speed, session.camera, session.gamma) == (0.5, "covered", 33.0)
    assert [other[name].value for name in ("speed", "gamma", "seed")] == ["half", "33", "3"]
    assert other["camera"].active == 1
    other["speed"].value = "3 times"
    assert run.pace.speed == 3.0
    one["pull_x"].value = 4
    other.click("next")
    for each in two:
        each.update()
        assert [each[name].value for name in ("seed", "gamma", "pull_x")] == ["4", "41.75", 0]
        assert each["camera"].active == 0
    # What the pages set in their widgets is nobody's wish.
    assert (session.scene, session.recorded().hands.force) == (run.session.scene, [])
    scene = session.scene
    one["rnn"].value = "gru"
    other.update()
    assert (session.scene, other["rnn"].value) == (scene + 1, "gru")
    one["seed"].value = "many"
    assert "seed &#x27;many&#x27; is no whole number" in one["message"].text
    assert one["seed"].value == "4"


def test_a_scene_that_diverged_is_said_in_the_page(session, run, two, monkeypatch):
    one = two[0]
    with monkeypatch.context() as patch:
        patch.setattr(session.rollout, "advance", lambda _: False)
        run.single()
    for name in ("single", "pause", "move"):
        one["message"].text = ""
        one.click(name)
        assert "the simulation diverged: begin another scene" in one["message"].text
    one.update()
    assert run.paused
    one.click("next")
    assert not run.paused
    session.tick()


def test_a_click_at_the_fastest_acts_within_some_slices(session, run, monkeypatch):
    """A message takes several rounds of the loop, all in the thread of the session (Bokeh 3.10 has others)."""
    took, failures, held_at, slices, hold, work = [], [], [], [], session.hold, run.work
    serving, threads = [True], set()

    def seen(holder, held):
        threads.add(threading.current_thread())
        held_at.append(len(slices))
        hold(holder, held)

    def counted():
        slices.append(session.ticks)
        return work()

    def visit(url):
        try:
            client = pull_session(url=url)
            hand = client.document.get_model_by_name("hand")
            run.set_speed(0.0)
            for held in (1, 0, 1, 0):
                time.sleep(0.3)
                before = len(slices)
                hand.data = {"hold": [held]}
                client.force_roundtrip()
                took.append(held_at[-1] - before)
                assert bool(session._holders) == bool(held)
        except BaseException as error:
            failures.append(error)
        finally:
            if serving:  # else it would end the tests
                os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(session, "hold", seen)
    monkeypatch.setattr(run, "work", counted)
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    try:
        serve(run, port, "about:blank", lambda url: threading.Thread(target=visit, args=(url,)).start())
    finally:
        serving.clear()
    assert not failures
    assert len(took) == 4
    assert max(took) <= 4
    assert threads == {threading.main_thread()}
    assert len(set(slices)) > 8


def test_space_bar_and_button_hold_each_for_itself_and_the_view_gives_the_keys_back(browser):
    page = browser.new_page(viewport={"width": 600, "height": 500})
    page.set_content(
        '<div style="height: 80px"><button class="hold-the-arm">hold</button></div>'
        '<iframe srcdoc="a scene" style="width: 300px; height: 300px"></iframe>'
    )
    page.add_script_tag(content=f"const hand = window.hand = {{data: {{hold: [0]}}}}; {{ {HOLDING} }}")

    def held():
        return page.evaluate("window.hand.data.hold[0]")

    page.keyboard.down("Space")
    page.mouse.click(500, 40)
    assert held() == 1
    page.keyboard.up("Space")
    assert held() == 0
    box = page.locator("button").bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.keyboard.press("Space")
    assert held() == 1
    page.mouse.up()
    assert held() == 0
    page.keyboard.down("Space")
    page.mouse.click(100, 250)  # in the view
    assert held() == 0
    page.keyboard.up("Space")
    page.keyboard.down("Space")
    assert held() == 0
    page.keyboard.up("Space")
    page.mouse.move(500, 40)
    page.mouse.move(510, 40)
    page.keyboard.down("Space")
    assert held() == 1
    page.keyboard.up("Space")
    page.close()
