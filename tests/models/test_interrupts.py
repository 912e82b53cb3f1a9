"""Programs that are told to end: one line, the exit code, and what was finished is kept."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import torch

from models import command_line, interrupts
from models.command_line import ROOT, run
from models.errors import InputError
from models.interrupts import Interrupted, held, leave_if_asked, listening
from models.networks.onnx_export import policy_graph
from models.networks.rnn import make_rnn

PROGRAM = """
import sys, time
from pathlib import Path
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from models.command_line import run
from tests.diagrams.episodes import pool_jobs

def main(_):
    with RowStore(Path(sys.argv[1]), {}) as store, Pool(int(sys.argv[2])) as pool:
        for job, row in pool.run(pool_jobs.slow_after_two, range(50)):
            store.add(str(job), row)
    return 0

if __name__ == "__main__":
    run(main, lambda: None)
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_program_with_workers_ends_in_one_line_and_keeps_its_rows(tmp_path, number, code):
    script, rows = tmp_path / "program.py", tmp_path / "rows.jsonl"
    script.write_text(PROGRAM)
    surroundings = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), str(rows), "2"]
    program = subprocess.Popen(
        command, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    end = time.monotonic() + 100
    while not rows.exists() or rows.read_bytes().count(b"\n") < 3:
        assert time.monotonic() < end
        time.sleep(0.02)
    os.killpg(program.pid, number)  # as Ctrl-C does at a terminal: workers too
    out, err = program.communicate(timeout=50)  # the jobs under way take minutes
    assert (program.returncode, out) == (code, "")
    assert err == f"interrupted: {rows} keeps what was finished, 2 rows: the same command goes on\n"
    while group_lives(program.pid):
        assert time.monotonic() < end
        time.sleep(0.05)


def group_lives(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def asked_twice(done):
    """Within two blocks, the inner one ended; then again."""
    with held():
        with held():
            signal.raise_signal(signal.SIGTERM)
            done.append(interrupts.asked())
        done.append("not raised yet")
        if len(done) > 2:
            signal.raise_signal(signal.SIGINT)
            done.append("not reached")


def test_a_request_is_held_back_till_the_end_of_the_block_and_a_second_one_is_not():
    done = []
    with listening():
        with pytest.raises(Interrupted) as ended:
            asked_twice(done)
        assert (ended.value.number, done) == (signal.SIGTERM, [True, "not raised yet"])
    with listening():
        with pytest.raises(Interrupted) as ended:
            asked_twice(done)
        assert (ended.value.number, len(done)) == (signal.SIGINT, 4)
    assert not interrupts.asked()
    assert signal.getsignal(signal.SIGINT) is not interrupts._note
    leave_if_asked()


def test_what_was_said_is_not_said_again(monkeypatch, capfd):
    """A second Ctrl-C while the process ends."""
    monkeypatch.setattr(os, "_exit", lambda code: None)
    monkeypatch.setattr(interrupts._State, "said", False)
    interrupts._end(signal.SIGINT, None)
    assert "before it began" in capfd.readouterr().err
    with pytest.raises(Interrupted), listening():
        signal.raise_signal(signal.SIGINT)
    interrupts._end(signal.SIGINT, None)
    assert capfd.readouterr().err == ""


def test_what_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with listening():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_torch_does_not_take_a_request_for_a_failure_of_its_own(monkeypatch):
    export = torch.onnx.export

    def swallowing(*arguments, **keywords):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise torch.onnx.OnnxExporterError("half an import") from None
        return export(*arguments, **keywords)

    monkeypatch.setattr(torch.onnx, "export", swallowing)
    with listening(), pytest.raises(Interrupted):
        policy_graph(make_rnn("lstm", 8, 2), None)


def test_an_error_is_not_replaced_by_a_request_that_came_with_it():
    with listening(), pytest.raises(ValueError, match="first"):
        fail_when_asked()


def fail_when_asked():
    with held():
        signal.raise_signal(signal.SIGINT)
        raise ValueError("first")


def test_a_library_that_takes_a_request_for_its_own_failure_does_not_hide_it(capsys):
    """torch does: an import that is broken off is an error of what needs it, some calls later."""

    def main(_):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except BaseException:
            raise InputError("the network cannot be exported") from None

    with pytest.raises(SystemExit) as end:
        run(main, lambda: None)
    assert end.value.code == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "interrupted: start it again\n"


def test_pressed_again_while_threads_end_it_is_one_line_still(tmp_path):
    script = tmp_path / "program.py"
    script.write_text(
        "import threading, time\n"
        "from models.command_line import run\n"
        "def main(_):\n"
        "    threading.Thread(target=time.sleep, args=(3.0,)).start()\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(60.0)\n"
        "run(main, lambda: None)\n"
    )
    program = subprocess.Popen(
        [sys.executable, str(script)], env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert program.stdout.readline() == "ready\n"
    program.send_signal(signal.SIGINT)
    assert program.stderr.readline() == "interrupted: start it again\n"
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=50)
    assert (program.returncode, out, err) == (130, "", "")


def test_threads_that_end_soon_are_waited_for_and_others_are_not():
    soon, held_up = threading.Timer(0.2, lambda: None), threading.Event()
    late = threading.Thread(target=held_up.wait)
    for thread in (soon, late):
        thread.start()
    try:
        command_line._let_threads_end()
        assert (soon.is_alive(), late.is_alive()) == (False, True)
    finally:
        held_up.set()
        late.join()
