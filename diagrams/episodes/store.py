"""The one store for what is resumed: rows appended to a file, a line of JSON each, on disk before they are counted."""

import dataclasses
import json
import os
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, TypeVar, Union, get_args, get_origin, get_type_hints

from models.checks import require_plain
from models.errors import InputError
from models.files.container import lock, naming
from models.interrupts import held

R = TypeVar("R")
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
        self.path, self.rows, self._option = path, dict[str, Any](), option
        fingerprint = json.loads(json.dumps(fingerprint))
        require_plain(path, f"choose another {option}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise InputError(f"{path} cannot be written ({error.strerror}): choose another {option}") from error
        try:
            with naming(path):
                lock(self._file, path, option)
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
                    found = dict(entry["fingerprint"])
                    if len(lines) > 2:  # else nothing is there that was made with it
                        _require_same(path, found, fingerprint, option)
                    whole *= found == fingerprint
                else:
                    self.rows[entry["key"]] = entry["row"]
            except InputError:
                raise
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                # Without its first line, which says what the rows were made with, none of them is of use.
                remedy = f"delete that line, or choose another {option}" if number > 1 else f"choose another {option}"
                raise InputError(f"{path} is damaged in line {number}: {remedy}") from error
        self._file.truncate(whole)
        if not whole:
            self._write({"fingerprint": fingerprint})

    def read(self, key: str, of: Callable[[Any], R]) -> R:
        """`of` of the row under `key`; raises InputError where it is none that `of` can read."""
        try:
            return of(self.rows[key])
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(
                f"{self.path} is damaged in the row {key!s:.80}: delete that line, or choose another {self._option}"
            ) from error

    def add(self, key: str, row: Any) -> None:
        """Adds a row (plain types) under `key`, over an earlier one; it is on disk when this returns.

        An OSError, as of a full disk, leaves the file as it was.
        """
        with held():
            self._write({"key": key, "row": row})
            self.rows[key] = row

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object = None, error: BaseException | None = None, trace: object = None) -> None:
        self._file.close()
        if isinstance(error, KeyboardInterrupt | OSError):
            error.add_note(f"{self.path} keeps what was finished, {len(self.rows)} rows: the same command goes on")

    def _write(self, content: dict[str, Any]) -> None:
        # NaN and infinity, which a row may hold, are Python's own words.
        line = json.dumps(content).encode() + b"\n"
        size = self._file.seek(0, os.SEEK_END)
        with naming(self.path):
            try:
                while line:
                    line = line[self._file.write(line) :]
                os.fsync(self._file.fileno())
            except OSError:
                self._file.truncate(size)  # no half of a line that a later one would follow
                raise


def of_plain(kind: Any, value: Any) -> Any:
    """What `asdict` and JSON made of a `kind`, a dataclass or what its fields are, once more as one.

    Raises ValueError, TypeError, AttributeError or OverflowError where a value has another type: Python itself looks
    at none.
    """
    if get_origin(kind) in (Union, types.UnionType):
        if value is None:
            return None
        [kind] = [part for part in get_args(kind) if part is not type(None)]
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{name: of_plain(hints.get(name, type(None)), inner) for name, inner in value.items()})  # type: ignore[operator]
    if get_origin(kind) in (list, tuple):
        inner, *others = get_args(kind)
        if not isinstance(value, list | tuple) or (
            others and others[-1] is not Ellipsis and len(value) != 1 + len(others)
        ):
            raise ValueError(f"{value!s:.60} is no {kind}")
        return get_origin(kind)(of_plain(inner, entry) for entry in value)  # type: ignore[misc]
    fits = isinstance(value, int | float) if kind is float else isinstance(value, kind)
    if not fits or (isinstance(value, bool) and kind is not bool):
        raise ValueError(f"{value!s:.60} is no {kind}")
    return float(value) if kind is float else value


def _require_same(path: Path, have: dict[str, Any], want: dict[str, Any], option: str) -> None:
    for name in want.keys() | have.keys():
        if (old := have.get(name)) != (new := want.get(name)):
            raise InputError(
                f"{path} was made with another {name} ({old!s:.80}, now {new!s:.80}): "
                f"choose another {option}, or go on as it was begun"
            )
