"""Registries: the one list of the networks, and the one of the detectors, by name; open to other packages."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from models.errors import InputError

T = TypeVar("T")


class Registry(Generic[T]):
    """Classes (or objects) with an attribute `name`, found by that name, by an entry point, or by `package.module:Class`.

    A package adds its own under the entry point group `hindsight.<what>s`; `package.module:Class` names one without installing it.
    """

    def __init__(self, what: str):
        """`what`: what the entries are, for messages and the entry point group: "network" or "detector"."""
        self.what, self._entries = what, dict[str, T]()

    def add(self, entry: T) -> T:
        """Registers `entry` under its `name`; returns it, so that it serves as a decorator of a class."""
        self._entries[entry.name] = entry  # type: ignore[attr-defined]
        return entry

    def __iter__(self) -> Iterator[str]:
        """The names that can be chosen: ours first, then those of entry points."""
        yield from dict.fromkeys([*self._entries, *(point.name for point in self._points())])

    def __getitem__(self, spec: str) -> T:
        """The entry that `spec` names: a name, or `package.module:Class`. Raises InputError where there is none."""
        if spec in self._entries:
            return self._entries[spec]
        if ":" in spec:
            return self._load(spec)
        for point in self._points():
            if point.name == spec:
                return self._load(point.value)
        raise InputError(
            f"there is no {self.what} '{spec}': choose from {', '.join(self)}, or give one as package.module:Class"
        )

    def label(self, spec: str) -> str:
        """The short name of what `spec` names: for file names, tables and pictures."""
        return self[spec].name  # type: ignore[attr-defined]

    def _points(self):
        return entry_points(group=f"hindsight.{self.what}s")

    def _load(self, spec: str) -> T:
        module, _, name = spec.partition(":")
        try:
            entry = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(
                f"the {self.what} '{spec}' cannot be loaded ({error}): check the name and PYTHONPATH"
            ) from error
        if not isinstance(getattr(entry, "name", None), str):
            raise InputError(f"the {self.what} '{spec}' has no attribute `name`: give it a short one")
        return entry
