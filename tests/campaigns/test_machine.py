"""A small slice of the campaign on the machine: one program, on some machines that are not as they should be."""

import os
import subprocess
import sys
import sysconfig
import time

import pytest

from diagrams.drawing.graph import graph_program
from models.command_line import ROOT
from models.errors import InputError
from tests.campaigns.conditions import CONDITIONS as ALL
from tests.campaigns.machine import _executed

SLICE = ["file size", "open files", "name", "two programs"]


def test_a_program_ends_well_on_a_machine_that_is_not_as_it_should_be(tmp_path):
    command = [sys.executable, "tests/campaigns/machine.py", "--targets", "teach", "--count", "1", "--conditions"]
    ended = subprocess.run(
        [*command, *SLICE, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == "4 of 4 answered well"


def test_no_graphviz_is_without_it(monkeypatch):
    monkeypatch.setenv("PATH", os.environ["PATH"])
    monkeypatch.setattr(sysconfig, "get_path", sysconfig.get_path)
    assert graph_program()
    ALL["no Graphviz"].on(0, None)
    with pytest.raises(InputError, match=r"no program `dot`.*: install Graphviz or"):
        graph_program()


def test_the_clock_is_set_back_in_workers_too():
    code = (
        "import multiprocessing; pool = multiprocessing.get_context('spawn').Pool(1); "
        "print(*(f('__import__(\"time\").time()') for f in (eval, lambda text: pool.apply(eval, (text,)))))"
    )
    ended = _executed(ALL["clock back"], [sys.executable, "-c", code], dict(os.environ))
    back = [time.time() - float(word) for word in ended.out.split()]
    assert back == pytest.approx([86400.0, 86400.0], abs=600.0)
