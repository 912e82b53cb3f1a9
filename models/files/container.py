"""What every weight file has in common: how it is read, written and named when it cannot be used."""

import hashlib
import os
import stat
from pathlib import Path
from typing import Any

from models.errors import InputError

FORMAT = 1
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


def write_bytes(path: str | Path, content: bytes) -> None:
    """Writes the file; it gets its name only when whole."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_bytes(content)
    os.replace(partial, path)


def require_kind(path: str | Path, header: dict[str, Any], kind: str) -> None:
    """Raises WeightsError unless `header` is that of a file of `kind` in this FORMAT."""
    have, wanted = (header.get("kind"), header.get("format")), (kind, FORMAT)
    if have != wanted:
        wrong = f"is a file of kind {have[0]!r}, format {have[1]!r}, where kind {kind!r}, format {FORMAT} is needed"
        raise WeightsError(path, wrong, "Give the file that was meant")
