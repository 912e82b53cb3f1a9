"""A slice of the coverage-guided campaign; and that what is not answered well is found."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from models.errors import InputError
from tests.campaigns.fuzz_bytes import READERS, FuzzBytesArguments, judged, main

CAMPAIGN = Path(__file__).parent / "fuzz_bytes.py"
HERE = importlib.util.find_spec("atheris") is not None


@pytest.mark.skipif(not HERE, reason="the package atheris is not installed")
def test_a_slice_is_answered_well(tmp_path):
    asked = [sys.executable, str(CAMPAIGN), "--count", "300", "--out", str(tmp_path)]
    for _ in range(2):  # and what is done is told again
        done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True)
        words = done.stdout.splitlines()
        assert words[-1:] == [f"{300 * len(READERS)} of {300 * len(READERS)} answered well"], done.stdout + done.stderr
        assert done.returncode == 0
    assert len(words) == 1 + len(READERS)


@pytest.mark.skipif(not HERE, reason="the package atheris is not installed")
@pytest.mark.parametrize(("fault", "words"), [("raise KeyError(3)", "KeyError: 3"), ("os._exit(3)", "ended with 3")])
def test_what_is_not_answered_well_is_kept_and_told(tmp_path, fault, words):
    code = f"""
import os, sys
from pathlib import Path
from tests.campaigns import fuzz_bytes

def read(path):
    if path.read_bytes()[:1] > b"a":
        {fault}

fuzz_bytes.READERS = {{"letters": lambda folder: (".txt", read, [b"a"])}}
sys.exit(fuzz_bytes.main(fuzz_bytes.FuzzBytesArguments(count=2000, out=Path({str(tmp_path)!r}))))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert words in done.stdout
    assert any((tmp_path / "0" / "letters").iterdir())


def test_an_answer_is_judged(tmp_path):
    def says(error):
        def read(_):
            raise error

        return judged(read, tmp_path)

    assert judged(lambda _: None, tmp_path) == ""
    assert says(InputError("the file is damaged: give another")) == ""
    assert says(InputError("the file is damaged")) == "names no remedy: the file is damaged"
    assert says(ValueError("no")) == "ValueError: no"


def test_bad_arguments_are_named():
    with pytest.raises(InputError, match="there is no reader 'poem': choose from scenario"):
        main(FuzzBytesArguments(readers=["poem"]))
    with pytest.raises(InputError, match="--count 0"):
        main(FuzzBytesArguments(count=0))
