"""The store: rows survive a kill, and rows of another world or code are not mixed in."""

from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diagrams.episodes.episode import Episode
from diagrams.episodes.fingerprint import code_hash, fingerprint
from diagrams.episodes.store import RowStore, of_plain
from diagrams.world.configuration import Timing, World
from diagrams.world.disturbance import DisturbanceSpec
from models.errors import InputError

IDENTITY = {"code": "abc", "seed": 0}


def rows_of(path):
    with RowStore(path, IDENTITY) as store:
        return store.rows


def test_rows_are_there_again(tmp_path):
    path = tmp_path / "new" / "rows.jsonl"
    with RowStore(path, IDENTITY) as store:
        store.add("a", {"x": 0.1, "none": None})
        store.add("b", [1, 2])
        store.add("a", {"x": 0.1 + 0.2})
    assert rows_of(path) == {"a": {"x": 0.1 + 0.2}, "b": [1, 2]}
    assert len(path.read_text().splitlines()) == 4


@settings(max_examples=50, deadline=None)
@given(st.floats(allow_nan=False), st.text())
def test_numbers_and_words_come_back_to_the_bit(tmp_path_factory, value, text):
    path = tmp_path_factory.mktemp("store") / "rows.jsonl"
    with RowStore(path, IDENTITY) as store:
        store.add(text, [value, text])
    ((key, (back, words)),) = rows_of(path).items()
    assert (key, words, np.float64(back).tobytes()) == (text, text, np.float64(value).tobytes())


@pytest.mark.parametrize("cut", range(1, 12))
def test_a_line_that_a_kill_left_unfinished_is_no_row(tmp_path, cut):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, IDENTITY) as store:
        store.add("a", 1)
        store.add("b", 2)
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    with RowStore(path, IDENTITY) as store:
        assert store.rows == {"a": 1}
        store.add("b", 2)
    assert path.read_bytes() == whole


def test_a_file_that_a_kill_left_without_its_first_line_begins_anew(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"finger')
    assert rows_of(path) == {}
    assert rows_of(path) == {}


def test_another_fingerprint_is_refused_with_both_values(tmp_path):
    path = tmp_path / "rows.jsonl"
    for identity in (IDENTITY | {"seed": 2}, IDENTITY):  # without a row it is of nothing yet
        RowStore(path, identity).__exit__()
    with RowStore(path, IDENTITY) as store:
        store.add("a", 1)
    with pytest.raises(InputError, match=r"made with another seed \(0, now 1\): choose another --out"):
        RowStore(path, IDENTITY | {"seed": 1})
    with pytest.raises(InputError, match=r"another more \(None, now 2\)"):
        RowStore(path, IDENTITY | {"more": 2})


@pytest.mark.parametrize("content", ["my notes", "my notes\n", '{"key": "a", "row": 1}\n', "\n", "\0"])
def test_a_file_of_somebody_else_is_left_as_it_is(tmp_path, content):
    path = tmp_path / "rows.jsonl"
    path.write_text(content)
    with pytest.raises(InputError, match=r"rows.jsonl holds no rows of this program: choose another --kept"):
        RowStore(path, IDENTITY, "--kept")
    assert path.read_text() == content


@pytest.mark.parametrize("first", ['{"fingerprint": [1]}', '{"fingerprint": 5}', '{"fingerprint": {"code"'])
def test_a_damaged_first_line_is_not_to_be_deleted(tmp_path, first):
    path = tmp_path / "rows.jsonl"
    path.write_text(first + '\n{"key": "a", "row": 1}\n')
    with pytest.raises(InputError, match=r"damaged in line 1: choose another --out$"):
        RowStore(path, IDENTITY)
    assert path.read_text().endswith('"row": 1}\n')


def test_damage_is_named_by_its_line(tmp_path):
    path = tmp_path / "rows.jsonl"
    with RowStore(path, IDENTITY) as store:
        store.add("a", 1)
    path.write_text(path.read_text() + "nonsense\n")
    with pytest.raises(InputError, match="damaged in line 3"):
        RowStore(path, IDENTITY)


def test_one_program_at_a_time(tmp_path):
    with RowStore(tmp_path / "rows", IDENTITY), pytest.raises(InputError, match="in use by another program"):
        RowStore(tmp_path / "rows", IDENTITY)


def test_a_folder_that_cannot_be_written_is_named():
    with pytest.raises(InputError, match=r"/dev/null/rows cannot be written .*choose another --out"):
        RowStore(Path("/dev/null/rows"), IDENTITY)


def test_the_fingerprint_knows_world_and_code(tmp_path):
    first, other = fingerprint(World()), fingerprint(World(timing=Timing(time_step=0.00625)))
    assert first == fingerprint(World())
    assert {name for name in first if first[name] != other[name]} == {"world.timing.time_step"}
    assert code_hash() != code_hash("diagrams/hybrid")
    path = tmp_path / "rows"
    with RowStore(path, first) as store:
        store.add("a", 1)
    with pytest.raises(InputError, match=r"another world.timing.time_step \(0.0125, now 0.00625\)"):
        RowStore(path, other)


@pytest.mark.parametrize("row", [[1], {"b": 2}, None, "a"])
def test_a_row_of_another_kind_is_named(tmp_path, row):
    with RowStore(tmp_path / "rows.jsonl", IDENTITY, "--there") as store:
        store.add("one", row)
        store.add("two", {"a": 2})
        assert store.read("two", lambda found: found["a"]) == 2
        with pytest.raises(InputError, match=r"rows.jsonl is damaged in the row one: .*another --there"):
            store.read("one", lambda found: found["a"])


@pytest.mark.parametrize(
    ("name", "value"),
    [("seed", "x"), ("seed", True), ("seed", 1.5), ("can_xy", [1.0]), ("can_xy", "ab"), ("can_xy", [1.0, 10**400]),
     ("way_home_clear", 1), ("vacant", None), ("disturbance", []), ("disturbance", {"level": "x"}), ("other", 1)],
)  # fmt: skip
def test_a_row_whose_values_are_of_another_type_is_named(tmp_path, name, value):
    episode = Episode(7, (0.5, 0), "left", DisturbanceSpec("A", 0.1, [0.0, 1], 3, subtask=2), way_home_clear=True)
    with RowStore(tmp_path / "rows.jsonl", IDENTITY) as store:
        store.add("one", asdict(episode))
        store.add("two", asdict(episode) | {name: value})
    with RowStore(tmp_path / "rows.jsonl", IDENTITY) as store:
        assert store.read("one", partial(of_plain, Episode)) == episode
        with pytest.raises(InputError, match="is damaged in the row two"):
            store.read("two", partial(of_plain, Episode))
