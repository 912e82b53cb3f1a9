"""A slice of the campaign of bad input: one of each kind, through the whole program; and what it would find."""

import subprocess
import sys

import pytest

from models.command_line import ROOT
from models.errors import InputError
from tests.campaigns import fuzz_case
from tests.campaigns.fuzz_case import Answer, Case, Special, accept, answer

FUZZ = ROOT / "tests" / "campaigns" / "fuzz.py"


@pytest.fixture(autouse=True)
def memory_of_this_process(monkeypatch):
    """A fork has all that the process of the suite has, which may be gigabytes."""
    monkeypatch.setattr(fuzz_case, "BYTES", 64 * 1024**3)


def test_a_slice_is_answered_well(tmp_path):
    asked = [sys.executable, str(FUZZ), "--seed", "1", "--count", "48", "--out", str(tmp_path)]
    done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1:] == ["48 of 48 answered well"], done.stdout + done.stderr
    assert done.returncode == 0


def test_every_program_and_command_is_fed():
    from tests.campaigns import fuzz, fuzz_inputs
    from tests.test_pages import CAMPAIGNS, PROGRAMS, SUBCOMMANDS

    names = {module: name for name, module in fuzz.PROGRAMS.items()}
    fed = {names[module] for module in PROGRAMS if module not in CAMPAIGNS} - {"analysis", "training"}
    fed |= {f"{names[module]} {command}" for module, commands in SUBCOMMANDS.items() for command in commands}
    assert set(fuzz_inputs.programs()) == fed


def test_all_cases_of_a_subject_are_run(tmp_path, monkeypatch, capsys):
    """Also where it takes turns with another one."""
    from tests.campaigns import fuzz

    class Made:
        def __init__(self, seed):
            self.strategies = [None]

        def __getitem__(self, number):
            return Case("weights a" if number % 3 else "weights b", "teach", [])

    monkeypatch.setattr(fuzz, "Inputs", Made)
    monkeypatch.setattr(fuzz, "answer", lambda *_: Answer(0, 0.1, 50.0, ""))
    for name in ("import_all", "leave_work_out"):
        monkeypatch.setattr(fuzz, name, lambda: None)
    assert fuzz.main(fuzz.FuzzArguments(count=9, subject="weights a", out=tmp_path)) == 0
    assert capsys.readouterr().out.endswith("\n6 of 6 answered well\n")


def refuses(argv):
    from models.command_line import run

    def main(words):
        raise InputError(f"{words[0]} is too large: choose less")

    run(main, lambda: argv)


def grows(argv):
    print("error: 5: choose another", file=sys.stderr)
    open("left", "w").close()
    sys.exit(2)


def changes(argv):
    with open("mine", "a") as file:
        file.write("more")
    sys.exit(0)


def raises(argv):
    raise RuntimeError("not foreseen")


def chats(argv):
    print("error: 5: choose another\nand more", file=sys.stderr)
    sys.exit(2)


def silent(argv):
    print("error: 5 does not fit that name", file=sys.stderr)
    sys.exit(2)


@pytest.mark.parametrize(
    ("main", "wrong"),
    [(refuses, None), (accept, None), (grows, "leaves left"), (changes, "changes mine"),
     (raises, "traceback: RuntimeError: not foreseen"), (chats, "says 2 lines"), (silent, "names no remedy")],
)  # fmt: skip
def test_what_is_not_well_is_seen(tmp_path, main, wrong):
    case = Case("trial", "none", ["5"], {"mine": b"mine", "pipe": Special("fifo")}, ("5",))
    found = answer(case, main, tmp_path / "scratch")
    assert (found.wrong or "").startswith(wrong or "")
    assert (found.wrong is None) == (wrong is None)


def test_another_name_than_the_value_is_not_enough(tmp_path):
    found = answer(Case("trial", "none", ["5"], {}, ("--episodes",)), refuses, tmp_path / "scratch")
    assert found.wrong == "names none of --episodes"
