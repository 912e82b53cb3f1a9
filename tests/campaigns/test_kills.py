"""A small slice of the kills: one program, killed and told to end."""

import subprocess
import sys

from models.command_line import ROOT


def test_a_program_that_is_killed_goes_on(tmp_path):
    command = [
        sys.executable,
        "tests/campaigns/kills.py",
        "--targets",
        "teach",
        "--hows",
        "kill",
        "int",
        "--count",
        "1",
    ]
    ended = subprocess.run(
        [*command, "--patience", "100", "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout) == (0, "2 of 2 answered well\n"), ended.stderr
    assert (tmp_path / "kills.jsonl").read_text().count('{"wrong": null}') == 2
