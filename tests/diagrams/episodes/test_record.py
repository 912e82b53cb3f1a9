"""Records on disk, and their hash."""

import numpy as np
import pytest

from diagrams.episodes.record import find_records, load_record, record_hash, save_record
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
