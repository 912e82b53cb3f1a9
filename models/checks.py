"""Checks of what a user gives, before any work is done for it: numbers, files that are read, files that are written."""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from models.errors import InputError

LARGEST_SEED = 10**9
SMALLEST = 1e-6  # of a number that has to be above 0

Range = tuple[float, float]  # least and most


def require_number(option: str, value: float, least: float, most: float) -> None:
    """Raises InputError unless `value` of `option` is a number from `least` to `most`."""
    if value < least:
        raise InputError(f"{option} {value} is too small: choose {least} or more")
    if value > most:
        raise InputError(f"{option} {value} is too large: choose at most {most}")
    if value != value:  # NaN
        raise InputError(f"{option} {value} is no number: choose from {least} to {most}")


def require_numbers(options: Any, ranges: Mapping[str, Range]) -> None:
    """The same of attributes by name; of a list each entry, of None nothing."""
    for name, (least, most) in ranges.items():
        given = getattr(options, name)
        for value in given if isinstance(given, list | tuple) else [given]:
            if value is not None:
                require_number(f"--{name.replace('_', '-')}", value, least, most)


def require_plain(path: str | Path, remedy: str = "give another name", largest: int | None = None) -> None:
    """Raises InputError where something is at `path` that is no plain file: to open a pipe or a device may hang.

    Also for a file of more than `largest` bytes.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "a pipe or a device"
        raise InputError(f"{path} is {what}, no plain file: {remedy}")
    if largest is not None and path.exists() and (size := path.stat().st_size) > largest:
        raise InputError(f"{path} has {size} bytes, more than {largest}: {remedy}")


def require_apart(written: Mapping[str, Path | None], read: Mapping[str, Path | None] | None = None) -> None:
    """Raises InputError for a file, by its option, that is to be written twice, or that is also read."""
    seen = {os.path.realpath(path): option for option, path in (read or {}).items() if path is not None}
    for option, path in written.items():
        if path is None:
            continue
        if (other := seen.setdefault(os.path.realpath(path), option)) != option:
            raise InputError(f"{option} {path} is the file of {other} too: choose another name")


def require_one_of(words: Sequence[str] | None, *options: str) -> None:
    """Raises InputError where a command line, `words` or the process's own, gives more than one of `options`.

    What an option says by default cannot be told from what it is given.
    """
    given = {word.split("=")[0] for word in (sys.argv[1:] if words is None else words)}
    if len(both := [option for option in options if option in given]) > 1:
        raise InputError(f"{' and '.join(both)} are given: leave one out")
