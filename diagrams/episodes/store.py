"""The one store for what is resumed: rows appended to a file, a line of JSON each, on disk before they are counted."""

import fcntl
import json
import os
from pathlib import Path
from typing import Any, Self

from models.checks import require_plain
from models.errors import InputError

FIRST = b'{"fingerprint": '  # how such a file begins


class RowStore:
    """Rows by key in a file whose first line is the fingerprint of what they were made with; a context manager.

    A kill in the middle of a line leaves a last line without its end: it is no row, and is cut off at the next start.
    """

    def __init__(self, path: Path, fingerprint: dict[str, Any], option: str = "--out"):
        """Opens or begins the file; `rows` then holds what is there. `option`: where the user gave its folder.

        Raises InputError where it cannot be written, belongs to a running program, is none of this program's or damaged
        (neither is changed), or was made with another `fingerprint` (plain types, see fingerprint.py).
        """
        self.path, self.rows = path, dict[str, Any]()
        fingerprint = json.loads(json.dumps(fingerprint))
        require_plain(path, f"choose another {option}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
        except OSError as error:
            raise InputError(f"{path} cannot be written ({error.strerror}): choose another {option}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{path} is in use by another program: wait for it, or choose another {option}") from error
        try:
            self._read(fingerprint, option)
        except BaseException:
            self._file.close()
            raise

    def _read(self, fingerprint: dict[str, Any], option: str) -> None:
        """The rows that are there; a fingerprint where there is none yet."""
        path = self.path
        self._file.seek(0)
        content = self._file.read(len(FIRST))
        if content == FIRST:  # else it is none of ours, and may be of any size
            content += self._file.read()
        if not content.startswith(FIRST[: len(content)]):
            raise InputError(f"{path} holds no rows of this program: choose another {option}")
        lines = content.split(b"\n")
        whole = sum(len(line) + 1 for line in lines[:-1])
        for number, line in enumerate(lines[:-1], start=1):
            try:
                entry = json.loads(line)
                if number == 1:
                    _require_same(path, dict(entry["fingerprint"]), fingerprint, option)
                else:
                    self.rows[entry["key"]] = entry["row"]
            except InputError:
                raise
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                # Without its first line, which says what the rows were made with, none of them is of use.
                remedy = f"delete that line, or choose another {option}" if number > 1 else f"choose another {option}"
                raise InputError(f"{path} is damaged in line {number}: {remedy}") from error
        self._file.truncate(whole)
        if len(lines) == 1:
            self._write({"fingerprint": fingerprint})

    def add(self, key: str, row: Any) -> None:
        """Adds a row (plain types) under `key`, over an earlier one; it is on disk when this returns."""
        self._write({"key": key, "row": row})
        self.rows[key] = row

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def _write(self, content: dict[str, Any]) -> None:
        # One line in one write; NaN and infinity, which a row may hold, are Python's own words.
        self._file.write(json.dumps(content).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())


def _require_same(path: Path, have: dict[str, Any], want: dict[str, Any], option: str) -> None:
    for name in want.keys() | have.keys():
        if (old := have.get(name)) != (new := want.get(name)):
            raise InputError(
                f"{path} was made with another {name} ({old!s:.80}, now {new!s:.80}): "
                f"choose another {option}, or go on as it was begun"
            )
