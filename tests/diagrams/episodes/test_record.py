"""Records on disk, and their hash."""

import dataclasses
import json

import numpy as np
import pytest

from diagrams.episodes.record import ARRAYS, find_records, load_record, record_hash, save_record
from models.errors import InputError
from tests.diagrams.episode_fakes import OUTCOME
from tests.diagrams.recorded_run import recorded_run


def test_record_survives_the_disk(tmp_path):
    before = recorded_run(3)
    save_record(tmp_path / "new" / "run.npz", before, OUTCOME)
    after, outcome = load_record(tmp_path / "new" / "run.npz")
    assert record_hash(after) == record_hash(before)
    assert after.events == before.events
    assert outcome["can_xy"] == list(OUTCOME.can_xy)
    assert {**outcome, "can_xy": OUTCOME.can_xy} == OUTCOME.to_dict()
    assert find_records([tmp_path / "new", tmp_path / "x.npz"]) == [tmp_path / "new" / "run.npz", tmp_path / "x.npz"]


def test_hash_sees_one_bit():
    one, other = recorded_run(3), recorded_run(3)
    other.posture[1, 3] = np.nextafter(other.posture[1, 3], 9)
    assert record_hash(one) != record_hash(other)


@pytest.mark.parametrize("name", ["text.npz", "other.npz", "nothing.npz", "cut.npz", "flipped.npz", "array.npz"])
def test_what_is_no_record_is_named(tmp_path, name):
    save_record(tmp_path / "whole.npz", recorded_run(3), OUTCOME)
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "other.npz", a=1)
    (tmp_path / "nothing.npz").write_bytes(b"")
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "flipped.npz").write_bytes(whole[:400] + bytes(200) + whole[600:])
    with (tmp_path / "array.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(InputError, match="holds no record") as caught:
        load_record(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no record .*none\.npz"):
        load_record(tmp_path / "none.npz")
    with pytest.raises(InputError, match="in the folder"):
        find_records([tmp_path])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"alpha": np.array([0.0, np.nan, 1.0])}, "alpha is float64 .*finite rows"),
        ({"alpha": np.array([0.0, 0.5, 1.5])}, "time or alpha are none"),
        ({"posture": np.zeros((2, 8))}, r"posture is float64 \(2, 8\) of 3 ticks"),
        ({"posture": np.zeros((3, 7))}, r"posture is \(3, 7\)"),
        ({"time": np.array([0.0, 0.2, 0.1])}, "time or alpha are none"),
        ({"picture_ticks": np.array([7])}, "picture_ticks are beyond the 3 ticks"),
        ({"errors": np.zeros((3, 1), complex)}, "errors is complex128"),
    ],
)
def test_arrays_that_are_no_run_are_named(tmp_path, changes, named):
    record = dataclasses.replace(recorded_run(3), **changes)
    np.savez(
        tmp_path / "r.npz",
        text=np.array(json.dumps({"events": record.events, "outcome": OUTCOME.to_dict()})),
        **{name: getattr(record, name) for name in ARRAYS},
    )
    with pytest.raises(InputError, match=rf"r\.npz holds no record, or a damaged one \(.*{named}"):
        load_record(tmp_path / "r.npz")


def test_a_record_without_ticks_is_none(tmp_path):
    save_record(tmp_path / "r.npz", recorded_run(0), OUTCOME)
    with pytest.raises(InputError, match=r"r\.npz holds no record.* no ticks"):
        load_record(tmp_path / "r.npz")


@pytest.mark.parametrize(("changes", "named"), [({"success": "yes"}, "has the success yes"), ({}, "no failure")])
def test_an_outcome_that_is_none_is_named(tmp_path, changes, named):
    record, outcome = recorded_run(3), OUTCOME.to_dict() | changes
    if not changes:
        del outcome["failure"]
    np.savez(
        tmp_path / "r.npz",
        text=np.array(json.dumps({"events": record.events, "outcome": outcome})),
        **{name: getattr(record, name) for name in ARRAYS},
    )
    with pytest.raises(InputError, match=f"the outcome .*{named}"):
        load_record(tmp_path / "r.npz")
