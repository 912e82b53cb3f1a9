"""Registries: the one list of the networks, detectors, policies and faults, by name; open to other packages."""

import hashlib
import importlib
import inspect
import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Generic, TypeVar

from models.command_line import EXTRAS
from models.errors import InputError

T = TypeVar("T")
_NAME = re.compile(r"[\w+][\w.+-]{0,99}")


class Registry(Generic[T]):
    """Classes with an attribute `name`, found by that name, by an entry point, or by `package.module:Class`.

    A package adds its own under the entry point group `hindsight.networks`, `hindsight.detectors`,
    `hindsight.policies` or `hindsight.faults`; `package.module:Class` names one without installing it. Nothing is
    imported before it is asked for.
    """

    def __init__(
        self,
        what: str,
        entries: dict[str, str],
        needs: tuple[str, ...] = (),
        families: dict[str, str] | None = None,
    ):
        """
        Args:
            what: "network", "detector", "policy" or "fault", for messages and the group.
            entries: ours, by name.
            needs: attributes without which a class is none.
            families: by a prefix, the function (package.module:function) that makes a class of what stands behind it:
                `prefix:rest` is function(rest), which raises InputError where there is none.
        """
        self.what, self._entries, self._needs, self._families = what, entries, needs, families or {}
        self.group = f"hindsight.{what}s".replace("ys", "ies")

    def __iter__(self) -> Iterator[str]:
        """The names that can be chosen: ours first, then those of entry points."""
        yield from self._specs()

    def __getitem__(self, spec: str) -> T:
        """The class that `spec` names: a name, or `package.module:Class`. Raises InputError where there is none."""
        known = self._specs()
        if spec not in known and ":" not in spec:
            choices = f"choose from {', '.join(known)}, or give" if known else "give"
            raise InputError(f"there is no {self.what} '{spec}': {choices} one as package.module:Class")
        module, _, name = known.get(spec, spec).partition(":")
        if spec not in known and module in self._families:
            of_family, _, function = self._families[module].partition(":")
            return getattr(importlib.import_module(of_family), function)(name)
        try:
            entry = getattr(importlib.import_module(module), name)
        except Exception as error:  # another one's module may raise anything
            if isinstance(error, ModuleNotFoundError) and error.name in EXTRAS["train"]:
                raise  # the program names the extra
            reason = f"{type(error).__name__}: {error}"
            wrong = f"the {self.what} '{spec}' cannot be loaded ({reason}): check the module, the name and PYTHONPATH"
            raise InputError(wrong) from error
        if not isinstance(getattr(entry, "name", None), str):
            raise InputError(f"the {self.what} '{spec}' has no attribute `name`: give it a short one")
        if absent := [name for name in self._needs if not hasattr(entry, name)]:
            raise InputError(f"'{spec}' is no {self.what}, it has no {', '.join(absent)}: give one that has")
        if not _NAME.fullmatch(entry.name):
            raise InputError(
                f"the {self.what} '{spec}' has the name '{entry.name}': files have it, give it letters, digits, "
                "_ . + and - alone"
            )
        if spec in known and entry.name != spec:
            wrong = f"the {self.what} '{spec}' calls itself '{entry.name}': give both one name"
            raise InputError(wrong)
        return entry

    def check(self, spec: str) -> None:
        """Raises InputError unless `spec` names something; loads only what is given as `package.module:Class`."""
        if not self._listed(spec):
            self[spec]

    def label(self, spec: str) -> str:
        """The short name of what `spec` names: for file names, tables and pictures."""
        return spec if self._listed(spec) else self[spec].name  # type: ignore[attr-defined]

    def code(self, spec: str) -> str:
        """SHA-256 (16 hexadecimal digits) of the file of another package's; "" for ours."""
        if spec in self._entries or spec.partition(":")[0] in self._families:
            return ""
        return hashlib.sha256(Path(inspect.getfile(self[spec])).read_bytes()).hexdigest()[:16]  # type: ignore[arg-type]

    def _listed(self, spec: str) -> bool:
        return spec in self._entries or spec in self._specs()  # what is installed is read from the disk each time

    def _specs(self) -> dict[str, str]:
        return self._entries | {point.name: point.value for point in entry_points(group=self.group)}
