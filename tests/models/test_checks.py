"""What is asked of numbers and files before work is done for them."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from models.checks import require_apart, require_number, require_numbers, require_one_of, require_plain
from models.errors import InputError


@pytest.mark.parametrize(
    ("value", "named"),
    [(0, "--n 0 is too small: choose 1 or more"), (11, "--n 11 is too large: choose at most 10"),
     (float("nan"), "--n nan is no number: choose from 1 to 10"), (float("inf"), "--n inf is too large"),
     (float("-inf"), "--n -inf is too small")],
)  # fmt: skip
def test_a_number_out_of_its_range_is_named_with_its_limit(value, named):
    with pytest.raises(InputError, match=f"^{named}"):
        require_number("--n", value, 1, 10)


def test_the_limits_themselves_are_inside():
    require_number("--n", 1, 1, 10)
    require_number("--n", 10, 1, 10)


@dataclass
class Options:
    some_factors: list[float] = field(default_factory=lambda: [1.0, 2.0])
    limit: int | None = None


def test_of_a_list_each_entry_counts_and_of_none_nothing():
    ranges = {"some_factors": (0.5, 3.0), "limit": (1, 2)}
    require_numbers(Options(), ranges)
    with pytest.raises(InputError, match=r"^--some-factors 4\.0 is too large"):
        require_numbers(Options([1.0, 4.0]), ranges)
    with pytest.raises(InputError, match=r"^--limit 0 is too small"):
        require_numbers(Options(limit=0), ranges)


def test_a_pipe_and_a_folder_are_no_plain_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    require_plain(tmp_path / "file")
    require_plain(tmp_path / "absent")
    with pytest.raises(InputError, match="pipe is a pipe or a device, no plain file: give another name"):
        require_plain(tmp_path / "pipe")
    with pytest.raises(InputError, match="is a folder, no plain file: delete it"):
        require_plain(tmp_path, "delete it")


def test_files_that_are_written_twice_or_read_too_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    require_apart({"--a": Path("x"), "--b": Path("y"), "--c": None}, {"--d": Path("z"), "--e": None})
    with pytest.raises(InputError, match=r"--b x is the file of --a too: choose another name"):
        require_apart({"--a": Path("x"), "--b": Path("./x")})
    with pytest.raises(InputError, match="--a x is the file of --d too"):
        require_apart({"--a": Path("x")}, {"--d": tmp_path / "x"})


def test_a_link_that_leads_to_itself_is_compared_as_it_is(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    require_apart({"--a": tmp_path / "loop"}, {"--b": tmp_path / "x"})
    with pytest.raises(InputError, match="loop is the file of --b too"):
        require_apart({"--a": tmp_path / "loop"}, {"--b": tmp_path / "loop"})


def test_options_that_exclude_each_other_are_seen_whatever_their_values():
    require_one_of(["--rnn", "lstm"], "--rnn", "--policy")
    with pytest.raises(InputError, match="--rnn and --policy are given: leave one out"):
        require_one_of(["--rnn=lstm", "--policy", "a:B"], "--rnn", "--policy")
