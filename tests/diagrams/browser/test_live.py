"""live.py in a real browser: hold, alpha rises in the page, let go, it falls, the task is done; the end by Ctrl-C.

The first is skipped without a Chromium on this machine.
"""

import re
import signal
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from diagrams import live
from diagrams.world.scenario import load_scenario
from models.command_line import ROOT
from models.errors import InputError

PATIENCE = 100.0  # s; a few on a free machine


def data(name):
    """JavaScript for the column `name` of what the plots show."""
    return f"Array.from(Bokeh.documents[0].get_model_by_name('live').data.{name})"


NEWEST = f"{data('alpha')}.at(-1)"


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Program:
    """live.py, running in `folder`."""

    def __init__(self, folder, *arguments):
        self.port, self.meshcat_port = free_port(), free_port()
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / "diagrams" / "live.py"), "--no-open", "--port", str(self.port),
             "--meshcat-port", str(self.meshcat_port), *arguments],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        for line in self.process.stdout:
            if "the page: " in line:
                return
        pytest.fail(self.process.stderr.read())

    def interrupt(self, number=signal.SIGINT):
        """Exit code, and what was printed since."""
        self.process.send_signal(number)
        out, errors = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out, errors

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()


def open_page(browser, program):
    """A page that has drawn something. Without the 3-D view, which takes a graphics card."""
    page = browser.new_page(viewport={"width": 1400, "height": 1000})
    page.set_default_timeout(1000 * PATIENCE)
    page.route(f"**:{program.meshcat_port}/**", lambda route: route.abort())
    page.goto(f"http://localhost:{program.port}/")
    page.wait_for_function(f"window.Bokeh && Bokeh.documents.length && {NEWEST} !== undefined")
    return page


def test_hold_alpha_rises_let_go_it_falls_the_task_is_done(browser, tmp_path):
    with Program(tmp_path) as program:
        page = open_page(browser, program)
        page.get_by_role("button", name="Next scene").click()
        page.wait_for_function(f"{data('time')}[0] == 0 && {data('m2')}.at(-1) > 36")  # 6 degrees off home
        assert page.evaluate(NEWEST) < 0.5
        button = page.locator(".hold-the-arm").first.bounding_box()
        page.mouse.move(button["x"] + button["width"] / 2, button["y"] + button["height"] / 2)
        page.mouse.down()
        page.wait_for_function(f"{NEWEST} > 0.9")
        page.get_by_text("the LQR brings the arm home").first.wait_for()
        page.mouse.up()
        page.keyboard.down("Space")
        page.wait_for_function(f"{data('active')}.at(-1) == 1")
        page.keyboard.up("Space")
        page.wait_for_function(f"{data('active')}.at(-1) == 0")
        # What a person types is judged in the page, and the scene goes on.
        page.get_by_label("gamma").fill("many")
        page.get_by_label("gamma").press("Enter")
        page.get_by_text("gamma 'many' is no number: type one").first.wait_for()
        assert page.get_by_label("gamma").input_value() == "41.75"
        page.get_by_label("speed").select_option("the fastest")
        page.wait_for_function(f"{NEWEST} < 0.1")
        page.get_by_text("at the initial posture").first.wait_for()
        page.get_by_text("recalls again: the network resumes").first.wait_for()
        second = open_page(browser, program)  # which sees the same
        second.get_by_text("task done").first.wait_for()
        page.get_by_text("task done").first.wait_for()
        page.get_by_role("button", name="Save").click()
        page.get_by_text("written: ").first.wait_for()
        page.screenshot(path=tmp_path / "page.png", timeout=1000 * PATIENCE)
        page.close()
        second.close()
        assert program.process.poll() is None  # no page ends it
        code, out, errors = program.interrupt()
        assert (code, errors) == (0, "")
        assert " ticks late at real time " in out
        assert "a tick takes " in out
    played = load_scenario(tmp_path / "outputs" / "live.yaml")  # of the first scene with hands in it
    assert played.seed == 1
    kinds = [row[1] for row in played.hands.grip]
    assert set(kinds) == {0, 1}
    assert (kinds[0], kinds[-1]) == (1, 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_without_a_page(number, tmp_path):
    with Program(tmp_path, "--speed", "0") as program:
        time.sleep(1.0)
        code, out, errors = program.interrupt(number)
        assert (code, errors) == (0, "")
        assert int(re.search(r"(\d+) ticks; 0 of 0 ticks late at real time", out).group(1)) > 0
        assert "written" not in out  # nobody did anything
    assert not list(tmp_path.glob("outputs/*"))


class BrokenError(Exception):
    pass


def test_what_was_done_is_written_where_a_tick_raises(tmp_path, monkeypatch):
    """And where it cannot be written, the program says so and does not hide what was raised."""
    from diagrams.browser import server

    def serve(run, *_):
        run.session.tick()
        run.session.pull([1.0, 0.0, 0.0])
        raise BrokenError

    monkeypatch.setattr(server, "serve", serve)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BrokenError):
        live.main(live.parse(["--no-open", "--meshcat-port", str(free_port())]))
    assert load_scenario(tmp_path / "outputs" / "live.yaml").hands.force == [[1.0, 1.0, 0.0, 0.0]]


def test_what_cannot_be_written_at_the_end_is_one_line(capsys):
    def keep():
        raise InputError("x cannot be written")

    assert not live._keep(SimpleNamespace(keep=keep))
    assert capsys.readouterr().err == "error: x cannot be written\n"
    assert live._keep(SimpleNamespace(keep=lambda: None))


def test_it_listens_on_this_machine_alone(tmp_path):
    with Program(tmp_path) as program, open("/proc/net/tcp") as v4, open("/proc/net/tcp6") as v6:
        rows = [line.split() for line in [*v4.read().splitlines()[1:], *v6.read().splitlines()[1:]]]
        ports = {f"{port:04X}" for port in (program.port, program.meshcat_port)}
        heard = {row[1] for row in rows if row[3] == "0A" and row[1].split(":")[1] in ports}
        assert heard <= {f"0100007F:{port}" for port in ports} | {f"{'0' * 24}01000000:{port}" for port in ports}
        assert len(heard) >= 2


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--speed", "-1"], "speed -1.0 cannot be: choose 0 .* or 0.05 and more"),
        (["--speed", "0.01"], "speed 0.01 cannot be"),
        (["--port", "80"], "--port 80 is no port that can be had"),
        (["--rnn", "perceptron"], "no network 'perceptron'"),
        (["--weights", "nowhere"], "no network 'lstm' in nowhere"),
        (["--save", "/dev/null/played.yaml"], "/dev/null/played.yaml cannot be written"),
        (["--save", "/dev/full"], "/dev/full is a pipe or a device, no plain file: give another name"),
    ],
)
def test_bad_input(arguments, named, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=named):
        live.main(live.parse([*arguments, "--no-open", "--meshcat-port", str(free_port())]))


def test_a_port_that_is_taken_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        with pytest.raises(InputError, match=f"port {port}.*choose another --port"):
            live.main(live.parse(["--port", port, "--meshcat-port", str(free_port()), "--no-open"]))
        with pytest.raises(InputError, match=f"port {port}.*choose another --meshcat-port"):
            live.main(live.parse(["--port", str(free_port()), "--meshcat-port", port, "--no-open"]))
