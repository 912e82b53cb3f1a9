import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest

from models.data.demonstrations import (
    DatasetError,
    Demonstration,
    content_of,
    iterate_frames,
    read_both_splits,
    read_demonstrations,
    read_header,
    subtask_ranges,
)
from models.data.motions import read_motions
from models.data.recording import RecordingFile
from tests.models import synthetic


def ramp(first: int, moving: int, last: int) -> np.ndarray:
    """One component standing, rising by 0.1 a tick, standing."""
    return np.concatenate([np.zeros(first), 0.1 * np.arange(1, moving + 1), np.full(last, 0.1 * moving)])


def demo(*parts: np.ndarray) -> Demonstration:
    starts = tuple(int(n) for n in np.cumsum([0, *[len(p) for p in parts[:-1]]]))
    posture = np.concatenate(parts)[:, None] * np.ones(8)
    return Demonstration("demo_0", "train", np.zeros(2), "left", starts, posture, posture)


def test_trims_dwell_to_three_ticks_at_the_start_and_fourteen_at_the_end() -> None:
    # Tick 12 is the first away from the start's posture, tick 20 the last away from the end's.
    assert subtask_ranges(demo(ramp(12, 10, 20), ramp(2, 10, 5))) == [(9, 35), (42, 59)]


def test_small_movement_counts_as_dwell() -> None:
    posture = ramp(12, 10, 20)
    posture[8] = 0.015
    assert subtask_ranges(demo(posture)) == [(9, 35)]
    posture[8] = 0.025
    assert subtask_ranges(demo(posture)) == [(5, 35)]


def test_nothing_moving_is_an_error() -> None:
    with pytest.raises(DatasetError, match="demo_0: nothing moves"):
        subtask_ranges(demo(np.zeros(30)))


def test_reads_the_layout(data_file: Path) -> None:
    demos = read_demonstrations(data_file)
    assert [d.name for d in demos] == [f"demo_{i}" for i in range(8)]
    assert {d.split for d in read_demonstrations(data_file, "valid")} == {"valid"}
    assert len(read_demonstrations(data_file, "train")) == 4
    assert demos[0].posture.shape == (100, 8)
    assert demos[0].subtask_starts == (0, 48)
    np.testing.assert_array_equal(read_header(data_file).initial_posture, synthetic.INITIAL_POSTURE)
    (rgb,) = iterate_frames(data_file, ["demo_1"])
    assert rgb.shape == (100, 112, 112, 3)
    assert rgb.dtype == np.uint8


def test_real_layout_trims_to_the_moving_part(data_file: Path) -> None:
    for one in read_demonstrations(data_file):
        for (start, stop), first in zip(subtask_ranges(one), one.subtask_starts, strict=True):
            assert first <= start < first + 12
            still = replace(one).posture[start]
            assert np.abs(one.posture[start + 2] - still).max() < 0.02 < np.abs(one.posture[start + 3] - still).max()
            assert stop <= len(one.posture)


def test_missing_and_damaged_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"none\.h5: the data set does not exist"):
        read_demonstrations(tmp_path / "none.h5")
    (tmp_path / "bad.h5").write_bytes(b"no data")
    with pytest.raises(DatasetError, match=r"bad\.h5 is no HDF5 .*record it again"):
        read_header(tmp_path / "bad.h5")
    h5py.File(tmp_path / "other.h5", "w").close()
    for read in (read_header, read_demonstrations, lambda path: next(iterate_frames(path, ["demo_0"]))):
        with pytest.raises(DatasetError, match=r"other\.h5 is damaged .*: record it again"):
            read(tmp_path / "other.h5")


def test_a_file_that_another_program_writes_is_not_called_damaged(data_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "d.h5"
    path.write_bytes(data_file.read_bytes())
    code = f"import h5py, sys; file = h5py.File({str(path)!r}, 'a'); print('open', flush=True); sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout.readline() == b"open\n"
        with pytest.raises(DatasetError, match=r"d\.h5 is in use by another program: wait"):
            read_header(path)
    assert read_header(path).content_hash == "00" * 32


def test_content_is_of_what_the_file_holds(data_file: Path, grown_data_file: Path, tmp_path: Path) -> None:
    assert read_header(data_file).content_hash == read_header(grown_data_file).content_hash
    assert content_of(data_file) == content_of(data_file) != content_of(grown_data_file)
    path = tmp_path / "d.h5"
    for change in ("data/demo_3/obs/posture", "data/demo_3/actions"):
        path.write_bytes(data_file.read_bytes())
        with h5py.File(path, "a") as file:
            file[change][7, 2] += 1e-9
        assert content_of(path) != content_of(data_file)
    path.write_bytes(data_file.read_bytes())
    with h5py.File(path, "a") as file:
        file["data"].attrs["content_hash"] = "11" * 32  # other pictures
    assert content_of(path) != content_of(data_file)


def _without(name):
    def change(file):
        del file[name]

    return change


def _instead(name, make):
    def change(file):
        value = file[name][()]
        del file[name]
        file[name] = make(value)

    return change


def _attribute(name, value):
    def change(file):
        file["data/demo_3"].attrs[name] = value

    return change


def _many_chunks(file):
    """None of which is there."""
    del file["mask/train"]
    file.create_dataset("mask/train", shape=(10**7,), dtype="S6", chunks=(1,))


def _never_written(file):
    del file["data/demo_3/obs/rgb"]
    file.create_dataset("data/demo_3/obs/rgb", shape=(100, 112, 112, 3), dtype="u1", chunks=(1, 112, 112, 3))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (_without("data/demo_3/actions"), "actions"),
        (_without("data/demo_3"), "demo_3"),
        (_without("data/demo_3/obs/rgb"), "rgb"),
        (_instead("data/demo_3/actions", lambda a: a[:-1]), r"actions \(99, 8\).*rows of one length"),
        (_instead("data/demo_3/obs/rgb", lambda a: a[:-1]), r"rgb \(99, 112, 112, 3\)"),
        (_instead("data/demo_3/obs/rgb", lambda a: a.transpose(0, 3, 1, 2)), r"rgb \(100, 3, 112, 112\).*pictures"),
        (_instead("data/demo_3/obs/posture", lambda a: a[:, :7]), r"posture \(100, 7\)"),
        (_instead("data/demo_3/obs/posture", lambda a: a * np.nan), "posture .*finite numbers"),
        (_attribute("subtask_starts", [0, 1000]), r"subtask_starts \(0, 1000\) of 100 ticks"),
        (_attribute("subtask_starts", [0, np.inf]), "infinity"),
        (_many_chunks, "/mask/train has 10000000 chunks, more than 100000"),
        (_never_written, r"/data/demo_3/obs/rgb has 0 chunks of 100"),
        (_attribute("subtask_starts", [0, 3]), "subtasks of 12 ticks or more"),
        (_attribute("can_xy", [1.0, 2.0, 3.0]), r"can_xy \[1\. 2\. 3\.\]"),
    ],
)
def test_a_demonstration_that_is_not_whole_is_named(data_file: Path, tmp_path: Path, change, named: str) -> None:
    path = tmp_path / "d.h5"
    path.write_bytes(data_file.read_bytes())
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(DatasetError, match=rf"d\.h5 is damaged \(.*{named}.*\): record it again"):
        read_demonstrations(path)


def _link(file, name, pipe):
    file[name] = h5py.ExternalLink(pipe, name)


def _virtual(file, name, pipe):
    layout = h5py.VirtualLayout((100, 8), float)
    layout[...] = h5py.VirtualSource(pipe, name, (100, 8))
    file.create_virtual_dataset(name, layout)


def _raw(file, name, pipe):
    file.create_dataset(name, (100, 8), float, external=[(pipe, 0, 6400)])


@pytest.mark.parametrize("read", [read_demonstrations, read_motions, lambda path: RecordingFile(path, {}, {})])
@pytest.mark.parametrize("elsewhere", [_link, _virtual, _raw])
def test_what_lies_in_another_file_is_refused_unread(data_file: Path, tmp_path: Path, elsewhere, read) -> None:
    """A pipe that nobody writes to would be waited for without end; of a file that is gone HDF5 reads zeros."""
    path, name = tmp_path / "d.h5", "data/demo_3/actions"
    path.write_bytes(data_file.read_bytes())
    os.mkfifo(tmp_path / "pipe")
    with h5py.File(path, "a") as file:
        del file[name]
        elsewhere(file, name, str(tmp_path / "pipe"))
    with pytest.raises(DatasetError, match=rf"d\.h5: {name} lies in another file: put it into this one"):
        read(path)


@pytest.mark.parametrize("split", ["train", "valid"])
def test_a_split_without_a_demonstration_is_named_with_the_file(data_file: Path, tmp_path: Path, split: str) -> None:
    assert len(read_both_splits(data_file)) == 8
    path = tmp_path / "d.h5"
    path.write_bytes(data_file.read_bytes())
    with h5py.File(path, "a") as file:
        _instead(f"mask/{split}", lambda names: names[:0])(file)
    for read in (read_both_splits, partial(read_demonstrations, split=split)):
        with pytest.raises(DatasetError, match=rf"d\.h5: the split {split} has no demonstration: teach more"):
            read(path)


def test_a_flipped_byte_in_a_chunk_is_named(data_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "d.h5"
    path.write_bytes(data_file.read_bytes())
    with h5py.File(path, "a") as file:
        posture = file["data/demo_0/obs/posture"][()]
        del file["data/demo_0/obs/posture"]
        # As teach.py writes them.
        written = file.create_dataset("data/demo_0/obs/posture", data=posture, compression="gzip", chunks=(32, 8))
        place = written.id.get_chunk_info(0)
    broken = bytearray(path.read_bytes())
    broken[place.byte_offset + place.size // 2] ^= 0x10
    path.write_bytes(bytes(broken))
    with pytest.raises(DatasetError, match=r"d\.h5 "):
        read_demonstrations(path)
