"""Scenario and world files are read strictly: nothing in them is passed over."""

import pytest

from diagrams.world.scenario import Scenario, load_scenario, load_world, save_scenario
from models.errors import InputError


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (b"seed: 1\nseed: 2\n", "line 2 gives the key 'seed' a second time: leave one out"),
        (b"world: {grid: {count: 10, spacing: 0.02, count: 12}}", "gives the key 'count' a second time"),
        (b"can: &a [0.5, 0.0]\ndisturbance: {kind: B, can_moved_to: *a}", "line 1|line 2 has an alias or a tag"),
        (b"rnn: !!python/object/apply:os.getcwd []", "line 1 has an alias or a tag: write out"),
        (b"", "it says nothing: write KEY: VALUE"),
        (b"# nothing\n", "it says nothing"),
        (b"- 1\n", "line 1 is no key with a value: write KEY: VALUE"),
        (b"null\n", "line 1 is no key with a value"),
        (b"seed: 1\n---\nseed: 2\n", "line 3 begins a second document"),
        (b"a: " + b"[" * 30, "more than 20 levels deep"),
        (b"x" * 1_000_001, "more than 1000000 bytes"),
        (b"seed: 1" + b":59" * 300_000, "line 1 has a key or value of 900001 characters: give at most 4096"),
        (b"seed: \xff\n", "'utf-8' codec can't decode"),
        (b"_seed: 1\n", "there is no key '_seed': known are rnn, detector, seed"),
        (b"world: {timing: {perod: 0.1}}", r"there is no key 'world\.timing\.perod': known are period, time_step"),
        (b"world: null\n", "world is None, where keys of its own belong"),
        (b"disturbance: none\n", "disturbance is none, where keys of its own belong"),
        (b"seed: 1.0\n", "seed is 1.0, where a whole number belongs"),
        (b"seed: true\n", "seed is True, where a whole number belongs"),
        (b"can: 5\n", "can is 5, where a list belongs"),
        (b"can: [0.5, left]\n", r"can\[1\] is left, where a number belongs"),
        (b"rnn: 5\n", "rnn is 5, where a word belongs"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, text, named):
    path = tmp_path / "s.yaml"
    path.write_bytes(text)
    with pytest.raises(InputError, match=f"s.yaml does not fit: (.*)({named})"):
        load_scenario(path)


@pytest.mark.parametrize("text", [b"\xef\xbb\xbfseed: 3\r\n", b"seed: 3 # three\n", b"{seed: 3}"])
def test_what_other_editors_write_is_read(tmp_path, text):
    path = tmp_path / "s.yaml"
    path.write_bytes(text)
    assert load_scenario(path).seed == 3


def test_a_number_in_the_words_of_python_is_one(tmp_path):
    """1e-3 is a word in YAML 1.1, and what people write."""
    path = tmp_path / "w.yaml"
    path.write_text("clearance: {least: 1e-3}\n")
    assert load_world(path).clearance.least == 1e-3


def test_what_is_saved_is_read(tmp_path):
    save_scenario(tmp_path / "s.yaml", Scenario(), ["nothing differs"])
    assert load_scenario(tmp_path / "s.yaml") == Scenario()


def test_a_hold_without_end_is_refused(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("disturbance: {kind: B, level: 0.1, hold_ticks: 1000000000}\n")
    with pytest.raises(InputError, match=r"disturbance\.hold_ticks 1000000000 is too large: choose at most 10000"):
        load_scenario(path).check()
