"""The file of demonstrations: what is in it, what a kill leaves, and which files are refused untouched."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from models.command_line import ROOT
from models.data.demonstrations import read_demonstrations, read_header
from models.data.recording import RecordingFile, content_hash
from models.errors import InputError
from tests.diagrams.teacher_fakes import recording

SETTINGS = {"world": {"corner": (0.44, -0.09)}, "seed": 0}
ATTRIBUTES = {"initial_posture": np.arange(8.0), "period": 0.1, "seed": 0}


def names(indices):
    return [f"demo_{index}" for index in indices]


def record(path, indices, settings=SETTINGS, **changes):
    """Adds what is missing of `indices`; the content hash."""
    with RecordingFile(path, settings, ATTRIBUTES) as file:
        for index in indices:
            if f"demo_{index}" not in file:
                file.add(recording(index, **changes))
        return file.finish(names(indices))[0]


def test_what_is_written_is_what_is_read(tmp_path):
    path = tmp_path / "y.h5"
    record(path, range(3))
    demos = read_demonstrations(path)
    assert [demo.split for demo in demos] == ["train", "valid", "train"]
    for index, demo in enumerate(demos):
        given = recording(index)
        assert np.array_equal(demo.posture, given.posture)
        assert np.array_equal(demo.actions, given.actions)
        assert (demo.vacant, demo.subtask_starts) == ("left", (0, 15))
    assert read_header(path).initial_posture.tolist() == [*range(8)]
    with h5py.File(path) as file:
        assert (file["data"].attrs["total"], file["data"].attrs["period"]) == (120, 0.1)
        assert np.array_equal(file["data/demo_1/obs/rgb"][()], recording(1).rgb)
        assert file["data/demo_1/obs/rgb"].compression == "gzip"


def test_those_that_failed_are_named(tmp_path):
    with RecordingFile(tmp_path / "y.h5", SETTINGS, ATTRIBUTES) as file:
        for index in range(3):
            file.add(recording(index, success=index != 1))
        assert file.finish(names(range(3)))[1] == ["demo_1"]


def test_the_hash_is_that_of_what_is_listed(tmp_path):
    whole = record(tmp_path / "8.h5", range(8))
    path = tmp_path / "parts.h5"
    first = record(path, range(4))
    assert first != whole  # of another number of demonstrations
    assert record(path, range(8)) == whole
    assert read_header(path).content_hash == whole
    # Fewer again: the others stay in the file, but they are not what is read, so that a cache made of 8 does not fit.
    assert record(path, range(4)) == first
    assert len(read_demonstrations(path)) == 4
    for changes in ({"vacant": "right"}, {"split": "valid"}, {"posture": np.zeros((40, 8))}):
        assert record(tmp_path / f"{next(iter(changes))}.h5", range(4), **changes) != first


def test_the_order_of_writing_does_not_matter(tmp_path):
    with RecordingFile(tmp_path / "y.h5", SETTINGS, ATTRIBUTES) as file:
        for index in (2, 10, 0):
            file.add(recording(index))
        file.finish(names((0, 2, 10)))
    assert read_header(tmp_path / "y.h5").content_hash == record(tmp_path / "x.h5", (0, 2, 10))


def test_a_write_that_breaks_off_is_done_again(tmp_path):
    path = tmp_path / "y.h5"
    with RecordingFile(path, SETTINGS, ATTRIBUTES) as file, pytest.raises(TypeError):
        file.add(recording(0, success={}))  # nothing that HDF5 can store
    with h5py.File(path) as file:
        assert "demo_0" not in file["data"]
    assert record(path, [0]) == record(tmp_path / "x.h5", [0])
    with h5py.File(path) as file:
        assert set(file) == {"data", "mask"}


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (SETTINGS | {"seed": 1}, r"another seed: delete it"),
        ({"world": {"corner": (0.5, 0.0)}, "seed": 1}, "another seed and another world"),
    ],
)
def test_other_settings_are_refused(tmp_path, settings, named):
    path = tmp_path / "y.h5"
    record(path, [0])
    before = path.read_bytes()
    with pytest.raises(InputError, match=named):
        record(path, [0], settings)
    assert path.read_bytes() == before


@pytest.mark.parametrize("env_args", [None, '{"env_name": "Lift"}', "no JSON", 3])
def test_a_file_of_someone_else_is_refused_untouched(tmp_path, env_args):
    path = tmp_path / "theirs.h5"
    with h5py.File(path, "w") as file:
        file["mask/train"] = [b"demo_0"]
        if env_args is not None:
            file.create_group("data").attrs["env_args"] = env_args
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"theirs\.h5 is no recording of this program: choose another"):
        record(path, [0])
    assert path.read_bytes() == before


def test_a_damaged_file_is_named(tmp_path):
    path = tmp_path / "broken.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match=r"broken\.h5 is no HDF5 .* delete it"):
        record(path, [0])
    with pytest.raises(InputError, match=r"cannot be written \(Is a directory\)"):
        record(tmp_path, [0])
    with pytest.raises(InputError, match=r"/dev/null/y\.h5 cannot be written"):
        record(type(path)("/dev/null/y.h5"), [0])


@pytest.mark.parametrize("mode", ["r", "r+"])
def test_a_file_that_another_process_has_open_is_in_use_and_not_damaged(tmp_path, mode):
    path = tmp_path / "y.h5"
    record(path, [0])
    code = f"import h5py; file = h5py.File({str(path)!r}, {mode!r}); print('open', flush=True); input()"
    other = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    try:
        assert other.stdout.readline() == "open\n"
        with pytest.raises(InputError, match=r"y\.h5 is in use by another program") as refused:
            record(path, [0, 1])
        assert "delete" not in str(refused.value)
    finally:
        other.communicate("\n")
    record(path, [0, 1])


def test_the_hash_is_checked_against_the_file(tmp_path):
    path = tmp_path / "y.h5"
    record(path, range(2))
    with h5py.File(path, "r+") as file:
        assert content_hash(file) == file["data"].attrs["content_hash"]
        file["data/demo_1/actions"][3, 2] += 1e-9
        assert content_hash(file) != file["data"].attrs["content_hash"]


@pytest.mark.parametrize("limit", [30_000, 600_000, 1_400_000, 2_500_000])
def test_where_a_file_cannot_grow_one_line_says_so_and_what_is_there_stays(tmp_path, limit):
    """HDF5 itself would crash."""
    path = tmp_path / "y.h5"
    code = (
        "import resource, sys\nfrom pathlib import Path\nfrom models.command_line import run\n"
        "from tests.models.data.test_recording import record\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n"
        f"run(lambda _: record(Path({str(path)!r}), range(5)) and 0, lambda: None)"
    )
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith(f"error: {path}")
    assert "raise the limit of a file's size (ulimit -f)" in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert record(path, range(5)) == record(tmp_path / "whole.h5", range(5))
