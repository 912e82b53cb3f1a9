"""What every weight file has in common: how it is read, written and named when it cannot be used."""

import errno
import fcntl
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from models.errors import InputError

FORMAT = 1
OF_NO_FILE = errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN  # errors that say nothing about a path
RETRAIN = "Take the file from the repository again (git checkout), or train it with `python -m models.training`"


class WeightsError(InputError):
    """A weight file is missing, damaged, or of another kind than asked for. Arguments: path, what is wrong, remedy."""

    def __str__(self) -> str:
        path, wrong, remedy = self.args
        return f"{path}: {wrong}. {remedy}"


def read_bytes(path: str | Path, largest: int) -> bytes:
    """The file's content; raises WeightsError where it cannot be read, or has more than `largest` bytes."""
    try:
        if not stat.S_ISREG((found := os.stat(path)).st_mode):
            raise WeightsError(path, "is a folder, a pipe or a device, no weight file", RETRAIN)
        if (size := found.st_size) > largest:
            raise WeightsError(path, f"has {size} bytes, more than the {largest} of a weight file", RETRAIN)
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise WeightsError(path, "the weight file does not exist", RETRAIN) from error
    except OSError as error:
        wrong = f"the weight file cannot be read ({error.strerror})"
        raise WeightsError(path, wrong, "Check its permissions") from error


def file_hash(path: str | Path) -> str:
    """SHA-256 of the file, hexadecimal; raises WeightsError where it cannot be read."""
    return hashlib.sha256(read_bytes(path, 1 << 40)).hexdigest()


def partial_of(path: Path) -> Path:
    """The name under which this process writes `path` until it is whole; with its ending, which says the format."""
    return path.with_name(f"{path.stem}.{os.getpid()}.part{path.suffix}")


def remove_left_parts(path: Path) -> None:
    """Removes what processes that are no more left of `path` under their `partial_of`: a kill does, and it is large."""
    name = re.compile(rf"{re.escape(path.stem)}\.([1-9]\d{{0,8}})\.part{re.escape(path.suffix)}")
    with suppress(OSError):  # whatever keeps it there is said where the file itself is written
        for left in [*path.parent.iterdir()]:
            if (found := name.fullmatch(left.name)) and not _runs(int(found[1])):
                left.unlink()


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # another user's
        return True
    return True


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A name beside `path` to write to, see `partial_of`: it becomes `path` when the block has ended well, else goes.

    Makes the folder. An OSError of the block names `path`.
    """
    path = Path(path)
    if path.exists() and not path.is_file():  # a device, a pipe: it cannot be replaced, and is written to
        with naming(path):
            yield path
        return
    # Of a link that leads to itself the link: Path.resolve raises for one, up to Python 3.12, what is no OSError.
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    partial = partial_of(target)
    try:
        with naming(path):
            target.parent.mkdir(parents=True, exist_ok=True)
            remove_left_parts(target)
            yield partial
            os.replace(partial, target)
    finally:
        with suppress(OSError):
            partial.unlink()


def write_bytes(path: str | Path, content: bytes | memoryview) -> None:
    """Writes the file; it gets its name only when whole. An OSError names it."""
    with whole_file(path) as partial:
        partial.write_bytes(content)


def write_text(path: str | Path, content: str) -> None:
    """As `write_bytes`, in UTF-8, whatever this machine's language is."""
    write_bytes(path, content.encode())


@contextmanager
def locked(path: Path, option: str = "--out") -> Iterator[None]:
    """Holds `path`, a file that is there for the block alone; InputError where another program holds it.

    The kernel lets go of it, whatever ends the process. `option`: where the user gave the folder.
    """
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        with naming(path), ExitStack() as opened:
            file = opened.enter_context(path.open("ab"))
            lock(file, path.parent, option)
            if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
                opened.pop_all()
                break  # else it was the last one's, and is gone
    with file:
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def lock(file: IO, what: Path, option: str) -> None:
    """Locks the open `file` until it is closed; raises InputError where another program has it; `what` is in use."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            f"{what} is in use by another program: wait for its end, or choose another {option}"
        ) from error


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """An OSError of the block names `path`: one of a write, or a lock, has no name."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.errno in OF_NO_FILE:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def require_kind(path: str | Path, header: dict[str, Any], kind: str) -> None:
    """Raises WeightsError unless `header` is that of a file of `kind` in this FORMAT."""
    have, wanted = (header.get("kind"), header.get("format")), (kind, FORMAT)
    if have != wanted:
        wrong = f"is a file of kind {have[0]!r}, format {have[1]!r}, where kind {kind!r}, format {FORMAT} is needed"
        raise WeightsError(path, wrong, "Give the file that was meant")
