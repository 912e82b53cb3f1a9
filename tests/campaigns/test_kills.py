"""A small slice of the kills: one program, killed and told to end."""

import re
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
    assert ended.returncode == 0, ended.stderr
    told, well = ended.stdout.splitlines()
    assert re.fullmatch(r"told to end, all processes were gone after \d+\.\d\d s at most", told)
    assert well == "2 of 2 answered well"
    assert (tmp_path / "kills.jsonl").read_text().count('"wrong": null') == 2
