"""How files are written: whole or not at all; a lock that is the block's alone."""

import errno
import os
import subprocess
import sys

import pytest

from models.command_line import ROOT
from models.errors import InputError
from models.files.container import locked, naming, whole_file, write_bytes, write_text


def write_half(path, error):
    with whole_file(path) as partial:
        partial.write_bytes(b"half")
        assert (partial.parent, partial.suffix) == (path.parent, ".png")
        raise error


def test_a_file_is_whole_or_as_it_was(tmp_path):
    path = tmp_path / "folder" / "file.png"
    write_bytes(path, b"before")
    with pytest.raises(OSError, match="No space left") as refused:
        write_half(path, OSError(errno.ENOSPC, "No space left"))
    assert refused.value.filename == str(path)
    assert path.read_bytes() == b"before"
    with pytest.raises(KeyboardInterrupt):
        write_half(path, KeyboardInterrupt())
    assert [*path.parent.iterdir()] == [path]
    write_text(path, "9 ± 1")
    assert path.read_bytes() == b"9 \xc2\xb1 1"


def test_parts_of_dead_processes_go_with_the_next_write(tmp_path, monkeypatch):
    path = tmp_path / "a[1].b.ckpt"
    code = (
        "import os, signal\nfrom models.files.container import whole_file\n"
        f"with whole_file({str(path)!r}) as partial:\n"
        "    partial.write_bytes(b'half')\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    killed = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    killed.wait()
    assert [left.name for left in tmp_path.iterdir()] == [f"a[1].b.{killed.pid}.part.ckpt"]
    dead, child = killed.pid, subprocess.Popen(["sleep", "60"])  # that one runs
    names = [f"a[1].b.{os.getpid()}.part.ckpt.txt", f"a1.b.{dead}.part.ckpt", f"a[1].b.x{dead}.part.ckpt",
             f"a[1].b.{'9' * 30}.part.ckpt", "a[1].b.0.part.ckpt", f"a[1].b.{dead}.part.csv", f"b.{dead}.part.ckpt",
             f"a[1].b.{child.pid}.part.ckpt", "a[1].b.1.part.ckpt"]  # fmt: skip
    for name in names:
        (tmp_path / name).touch()
    kill = os.kill

    def of_another_user(pid, number):
        if pid == 1:
            raise PermissionError
        kill(pid, number)

    monkeypatch.setattr(os, "kill", of_another_user)
    write_bytes(path, b"whole")
    child.kill()
    assert {left.name for left in tmp_path.iterdir()} == {*names, path.name}
    child.wait()
    write_bytes(path, b"again")
    assert {left.name for left in tmp_path.iterdir()} == {*names, path.name} - {f"a[1].b.{child.pid}.part.ckpt"}


def test_errors_without_a_path_stay_so(tmp_path):
    with pytest.raises(OSError, match="open files") as refused, naming(tmp_path):
        raise OSError(errno.EMFILE, "too many open files")
    assert refused.value.filename is None


def test_a_lock_is_the_blocks_alone(tmp_path):
    path = tmp_path / "out" / "x.lock"
    with locked(path), pytest.raises(InputError, match=r"out is in use by another program: wait .* another --out"):
        locked(path).__enter__()
    assert not path.exists()
    with locked(path):
        assert path.exists()


def test_the_kernel_lets_go_of_a_killed_programs_lock(tmp_path):
    path = tmp_path / "x.lock"
    code = (
        "import os, signal\nfrom pathlib import Path\nfrom models.files.container import locked\n"
        f"with locked(Path({str(path)!r})):\n    os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=os.environ, check=False)
    assert path.exists()
    with locked(path):
        pass
    assert not path.exists()


def test_a_link_stays_and_a_device_is_written_to(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "far")
    write_bytes(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "far").read_bytes() == b"new"
    (tmp_path / "full").symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as refused:
        write_bytes(tmp_path / "full", b"new")
    assert refused.value.filename == str(tmp_path / "full")


def test_a_link_that_leads_to_itself_becomes_the_file(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    write_bytes(tmp_path / "loop", b"kept")
    assert (tmp_path / "loop").read_bytes() == b"kept"
