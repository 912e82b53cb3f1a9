"""A small slice of the campaign on the machine: one program, on some machines that are not as they should be."""

import subprocess
import sys

from models.command_line import ROOT

CONDITIONS = ["file size", "open files", "name", "two programs"]


def test_a_program_ends_well_on_a_machine_that_is_not_as_it_should_be(tmp_path):
    command = [sys.executable, "tests/campaigns/machine.py", "--targets", "teach", "--count", "1", "--conditions"]
    ended = subprocess.run(
        [*command, *CONDITIONS, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[-1] == "4 of 4 answered well"
