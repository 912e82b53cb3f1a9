"""Checkpoints of a training: resumed by the same command, refused by another."""

import io
import warnings
from pathlib import Path
from typing import Any

import torch

from models.checks import require_plain
from models.errors import InputError
from models.files.container import remove_left_parts, write_bytes

_FREE = {"checkpoint_every", "validate_every"}  # options that change no weight: a training may go on with others


class Checkpoint:
    """A file with the state after some update, replaced in one go, and what it was made with."""

    def __init__(self, path: Path, training: Any, optimizer: Any, made_with: dict[str, Any]) -> None:
        self.path, self.training, self.optimizer, self.made_with = path, training, optimizer, made_with
        self.done = 0

    def save(self, done: int, export: bool) -> None:
        """The weight file comes first: killed between the two, the training goes on from the checkpoint before."""
        state = self.training.state_dict()
        if not all(value.isfinite().all() for value in state.values()):
            raise self.diverged(f"a weight is not finite after update {done}")
        path = self.training.weight_file(done)
        if export and path is not None:
            self.training.export(path, done)
        stored = {"made_with": self.made_with, "done": done, "state": state, "optimizer": self.optimizer.state_dict()}
        content = io.BytesIO()
        torch.save(stored, content)  # not to the file: there torch has its own words for a full disk, and no name
        write_bytes(self.path, content.getbuffer())
        self.done = done

    def load(self) -> int:
        """The updates done so far; 0 without a file."""
        remove_left_parts(self.path)
        if not self.path.exists():
            return 0
        require_plain(self.path, "choose another --out")
        try:
            with warnings.catch_warnings():  # torch warns of what it then refuses
                warnings.simplefilter("ignore")
                stored = torch.load(self.path, map_location="cpu", weights_only=True)
            made_with, self.done = dict(stored["made_with"]), int(stored["done"])
        except Exception as error:  # whatever unpickling strange bytes may raise
            raise self._unusable(f"not a whole checkpoint of this program ({type(error).__name__})") from error
        refuse_other(self.path, made_with, self.made_with)
        try:
            if not 0 < self.done <= self.training.steps:
                raise ValueError(f"its updates, {self.done}, are not 1 to {self.training.steps}")
            if not all(torch.isfinite(value).all() for value in stored["state"].values()):
                raise ValueError("a weight is not finite")
            before = self.optimizer.state_dict()
            self.training.load_state_dict(stored["state"])
            self.optimizer.load_state_dict(stored["optimizer"])
            _require_alike(before["param_groups"], stored["optimizer"]["param_groups"])
            for parameter, moments in self.optimizer.state.items():
                _require_moments(parameter, moments)
        except Exception as error:  # whatever strange content may raise
            raise self._unusable(f"does not fit the network ({' '.join(str(error).split())[:200]})") from error
        return self.done

    def export_missing(self) -> None:
        """Writes the weight file of what was loaded, where it should be there and is not."""
        due = self.done % self.made_with["checkpoint_every"] == 0 or self.done == self.training.steps
        path = self.training.weight_file(self.done)
        if self.done and due and path is not None and not path.is_file():
            self.training.export(path, self.done)

    def diverged(self, what: str) -> InputError:
        """The error for a training that left the finite numbers."""
        kept = f"{self.path} keeps update {self.done}" if self.path.exists() else "there is no checkpoint yet"
        return InputError(f"{what}; {kept}: train with a lower --learning-rate into another --out")

    def _unusable(self, why: str) -> InputError:
        return InputError(f"{self.path}: {why}: delete it to train from the start, or choose another --out")


def _require_alike(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> None:
    """Raises ValueError where the optimizer's options are others; its rate is set at every update."""
    plain = [
        [{k: v for k, v in group.items() if k not in ("lr", "initial_lr")} for group in groups]
        for groups in (before, now)
    ]
    if plain[0] != plain[1]:
        raise ValueError("the optimizer has other options")


def _require_moments(parameter: Any, moments: dict[str, Any]) -> None:
    """Raises ValueError unless Adam's moments have the shape of their parameter, and are finite."""
    for name in ("exp_avg", "exp_avg_sq"):
        if moments[name].shape != parameter.shape or not torch.isfinite(moments[name]).all():
            raise ValueError(f"the optimizer's {name} does not fit")
    if not torch.isfinite(torch.as_tensor(moments["step"])).all():
        raise ValueError("the optimizer's step is not finite")


def refuse_other(path: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    """Raises InputError, with both values, where `path` was made with other options or data than those now."""
    before, now = _flat(before), _flat(now)
    others = [
        f"{key} {before.get(key)}, not {now.get(key)}"
        for key in sorted(before.keys() | now.keys())
        if key not in _FREE and before.get(key) != now.get(key)
    ]
    if others:
        raise InputError(f"{path} was made with {'; '.join(others)}: give the same, or another --out")


def _flat(nested: dict[str, Any]) -> dict[str, Any]:
    return {
        f"{key}.{inner}" if inner else key: value
        for key, content in nested.items()
        for inner, value in (_flat(content).items() if isinstance(content, dict) else [("", content)])
    }
