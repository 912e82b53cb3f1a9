"""A small slice of the kills: one program, killed and told to end; and which moments are no kills."""

import re
import subprocess
import sys
from types import SimpleNamespace

import pytest

from diagrams.episodes.store import RowStore
from models.command_line import ROOT
from tests.campaigns.kills import HOWS, MISSED, TOLD, Campaign, parse, until_hit


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
    ended = subprocess.run([*command, "--out", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    told, well = ended.stdout.splitlines()
    assert re.fullmatch(r"told to end, all processes were gone after [0-4]\.\d\d s at most", told)
    assert well == "2 of 2 answered well"
    assert (tmp_path / "kills.jsonl").read_text().count('"wrong": null') == 2


def process(code, err=""):
    """One that ended with `code`, before it was killed or by that."""
    return SimpleNamespace(
        pid=0, code=code, poll=lambda: True, wait=lambda seconds: True, kill=lambda: None, members=list,
        workers=list, ends_within=lambda patience: 0.5, ended=lambda: SimpleNamespace(code=code, err=err),
    )  # fmt: skip


@pytest.mark.parametrize("how", HOWS)
def test_what_had_ended_was_not_killed(how, tmp_path):
    campaign = Campaign(parse([]), tmp_path)
    assert campaign._strike(process(0), "teach", how, 0) == MISSED
    assert not campaign.seconds


@pytest.mark.parametrize("how", [how for how in HOWS if how != "worker"])
def test_what_was_killed_is_no_miss(how, tmp_path):
    campaign = Campaign(parse([]), tmp_path)
    code = TOLD[how][1] if how in TOLD else -9
    assert campaign._strike(process(code, "interrupted: the same command goes on\n"), "teach", how, 0) is None
    assert "exit code 1, not" in campaign._strike(process(1), "teach", how, 0)


def test_another_moment_is_drawn_where_nothing_was_hit():
    assert until_hit({1: MISSED, 2: MISSED, 3: None, 4: "wrong"}.get, [1, 2, 3, 4]) is None
    assert until_hit({1: MISSED, 2: "wrong", 3: None}.get, [1, 2, 3]) == "wrong"
    assert until_hit(lambda moment: MISSED, [1, 2]) == MISSED


def test_what_never_hits_is_counted_apart(tmp_path, capsys):
    campaign = Campaign(SimpleNamespace(workers=1), tmp_path)
    campaign.undisturbed = lambda name: {}
    cases = [("teach", "kill", number) for number in range(3)]
    with RowStore(tmp_path / "kills.jsonl", {}) as store:
        assert campaign.work(cases, store, lambda name, how, number, whole: MISSED if number == 2 else None) == 1
    assert capsys.readouterr().out == "2 of 3 answered well, 1 hit nothing\n"
