"""What the trainings share: options, the loop over updates, checkpoints, resuming.

A plain loop, no Lightning: it is shorter than what bent its Trainer to batches by (seed, step) and one checkpoint.
"""

from __future__ import annotations

import csv
import ctypes
import math
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from tqdm import tqdm

from models.errors import InputError

# Options that name places and this machine: they are not written into weight files.
_LOCAL = {"data", "out", "threads", "progress", "device", "encoder", "features", "policy", "start_from"}
# Options that change no weight: a training may go on with others.
_FREE = {"checkpoint_every", "validate_every"}
_COUNTS = ("steps", "batch_size", "max_images", "frame_stride", "horizon", "checkpoint_every", "validate_every")


@dataclass(kw_only=True)
class TrainingOptions:
    """Options of every training.

    Args:
        data: data set of diagrams/teach.py (HDF5).
        out: folder for the checkpoint, the log (CSV) and the weight files. The same command goes on with a training
            found there; other options, data or seeds are refused.
        seed: of initial weights, batches and augmentation.
        threads: threads of torch; 0 leaves torch's choice.
        progress: show a progress bar.
    """

    data: Path
    out: Path
    seed: int = 0
    threads: int = 0
    progress: bool = True

    def __post_init__(self) -> None:
        for name in _COUNTS:
            value = getattr(self, name, None)
            if value is not None and value < 1:
                raise InputError(f"--{name.replace('_', '-')} {value} is out of range: choose 1 or more")

    def as_metadata(self) -> dict[str, Any]:
        """The options for a weight file, without what belongs to this machine."""
        return {key: value for key, value in asdict(self).items() if key not in _LOCAL}


class Training(nn.Module):
    """What is trained for `steps` updates with Adam; the rate falls from learning_rate to final_rate by a cosine.

    Its state_dict is all that changes from update to update (beside Adam's own state).
    """

    def __init__(self, steps: int, learning_rate: float, final_rate: float) -> None:
        super().__init__()
        self.steps, self.learning_rate, self.final_rate = steps, learning_rate, final_rate

    def rate(self, step: int) -> float:
        """The learning rate of update `step`, counted from 0."""
        share = 0.5 * (1.0 + math.cos(math.pi * step / self.steps))
        return self.final_rate + (self.learning_rate - self.final_rate) * share

    def make_batch(self, step: int) -> Any:
        """The batch of one update, by (seed, step) alone: a resumed training takes the batches of an unbroken one."""
        raise NotImplementedError

    def loss(self, batch: Any, step: int) -> tuple[Tensor, dict[str, Tensor]]:
        """What is minimised, and figures for the log."""
        raise NotImplementedError

    def validate(self, done: int) -> dict[str, float]:
        """Figures on the validation split after `done` updates; {} where none are due."""
        return {}

    def weight_file(self, done: int) -> Path | None:
        """The weight file that goes with the checkpoint after `done` updates; None where none does."""
        raise NotImplementedError

    def export(self, path: Path, done: int) -> None:
        """Writes that weight file."""
        raise NotImplementedError


def step_generator(seed: int, step: int) -> torch.Generator:
    """The random generator of one update."""
    return torch.Generator().manual_seed(seed * 1_000_003 + step)


def fit(
    training: Training,
    options: Any,
    made_from: dict[str, str],
    *,
    name: str,
    clip: float | None = None,
    log_every: int = 50,
) -> None:
    """Trains to training.steps, from OUT/NAME.ckpt if it is there; logs to OUT/NAME.csv and OUT/NAME-validation.csv.

    Args:
        training: see Training.
        options: TrainingOptions with checkpoint_every.
        made_from: hashes of data and weights that the training starts from.
        name: of the checkpoint and the log.
        clip: largest norm of the gradient.
        log_every: updates between rows of the log.

    Raises:
        InputError: the checkpoint is damaged or of another training; the loss or a weight is not finite.
        SystemExit: 143 after SIGTERM, with a checkpoint of the last whole update.
    """
    optimizer = torch.optim.Adam(
        [p for p in training.parameters() if p.requires_grad], training.learning_rate, fused=True
    )
    checkpoint = _Checkpoint(options.out / f"{name}.ckpt", training, optimizer, options.as_metadata() | made_from)
    log, validation_log = (options.out / f"{name}{ending}.csv" for ending in ("", "-validation"))
    start = checkpoint.load()
    for path in (log, validation_log):
        _drop_rows(path, start)
    if start == training.steps:
        print(f"{checkpoint.path}: all {start} updates are done")
    training.train()
    bar = tqdm(
        range(start, training.steps), initial=start, total=training.steps, disable=None if options.progress else True
    )
    with _termination() as terminated:
        for step in bar:
            optimizer.param_groups[0]["lr"] = training.rate(step)
            loss, figures = training.loss(training.make_batch(step), step)
            if not math.isfinite(loss.item()):
                raise checkpoint.diverged(f"the loss of update {step + 1} is {loss.item()}")
            optimizer.zero_grad()
            loss.backward()
            if clip is not None:
                nn.utils.clip_grad_norm_(training.parameters(), clip)
            optimizer.step()
            done = step + 1
            if done % log_every == 0 or done == training.steps:
                row = {key: value.item() for key, value in figures.items()}
                _add_row(log, {"update": done, "rate": training.rate(step)} | row)
                bar.set_postfix({key: f"{value:.3g}" for key, value in row.items()}, refresh=False)
            if valid := training.validate(done):
                _add_row(validation_log, {"update": done} | valid)
                bar.write(f"update {done}: " + ", ".join(f"{key} {value:.4f}" for key, value in valid.items()))
            if done % options.checkpoint_every == 0 or done == training.steps:
                checkpoint.save(done, export=True)
            elif terminated:
                checkpoint.save(done, export=False)
            if terminated and done < training.steps:
                bar.close()
                print(f"terminated after update {done} of {training.steps}: the same command goes on", file=sys.stderr)
                raise SystemExit(143)


class _Checkpoint:
    """A file with the state after some update, replaced in one go, and what it was made with."""

    def __init__(self, path: Path, training: Training, optimizer: Any, made_with: dict[str, Any]) -> None:
        self.path, self.training, self.optimizer, self.made_with = path, training, optimizer, made_with
        self.done = 0

    def save(self, done: int, export: bool) -> None:
        """The weight file comes first: killed between the two, the training goes on from the checkpoint before."""
        state = self.training.state_dict()
        if not all(value.isfinite().all() for value in state.values()):
            raise self.diverged(f"a weight is not finite after update {done}")
        if export:
            self._export(done)
        partial = self.path.with_suffix(".part")
        stored = {"made_with": self.made_with, "done": done, "state": state, "optimizer": self.optimizer.state_dict()}
        torch.save(stored, partial)
        os.replace(partial, self.path)
        self.done = done

    def load(self) -> int:
        """The updates done so far; 0 without a file. A weight file that should be there and is not is written."""
        if not self.path.exists():
            return 0
        try:
            stored = torch.load(self.path, map_location="cpu", weights_only=True)
            made_with, self.done = dict(stored["made_with"]), int(stored["done"])
        except Exception as error:  # whatever unpickling strange bytes may raise
            words = f"{self.path}: not a whole checkpoint of this program ({type(error).__name__})"
            raise InputError(f"{words}: delete it to train from the start, or choose another --out") from error
        refuse_other(self.path, made_with, self.made_with)
        try:
            self.training.load_state_dict(stored["state"])
            self.optimizer.load_state_dict(stored["optimizer"])
        except (KeyError, RuntimeError, ValueError) as error:
            words = f"{self.path}: does not fit the network ({' '.join(str(error).split())[:200]})"
            raise InputError(f"{words}: delete it to train from the start, or choose another --out") from error
        if self.done % self.made_with["checkpoint_every"] == 0 or self.done == self.training.steps:
            self._export(self.done, only_missing=True)
        return self.done

    def diverged(self, what: str) -> InputError:
        """The error for a training that left the finite numbers."""
        kept = f"{self.path} keeps update {self.done}" if self.path.exists() else "there is no checkpoint yet"
        return InputError(f"{what}; {kept}: train with a lower --learning-rate into another --out")

    def _export(self, done: int, only_missing: bool = False) -> None:
        path = self.training.weight_file(done)
        if path is not None and not (only_missing and path.is_file()):
            self.training.export(path, done)


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


@contextmanager
def _termination() -> Iterator[list[int]]:
    """A list that is no longer empty once the process was asked to end (SIGTERM)."""
    received: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    try:
        yield received
    finally:
        signal.signal(signal.SIGTERM, before)


def _add_row(path: Path, row: dict[str, Any]) -> None:
    new = not path.exists() or not path.stat().st_size
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)


def _drop_rows(path: Path, done: int) -> None:
    """Drops the rows of updates beyond `done`, which come once more, and a row that was cut off."""
    if path.exists():
        header, *rows = path.read_text().splitlines(keepends=True) or [""]
        kept = [row for row in rows if row.endswith("\n") and int(row.split(",")[0]) <= done]
        path.write_text("".join([header, *kept]) if kept else "")


def prepare(options: TrainingOptions) -> None:
    """The output folder, threads and seed."""
    options.out.mkdir(parents=True, exist_ok=True)
    if sys.platform == "linux":
        try:
            libc = ctypes.CDLL("libc.so.6")
        except OSError:  # another C library: only slower
            pass
        else:  # glibc keeps large freed blocks: handing them back to the kernel after every update costs time
            libc.mallopt(-4, 0)  # M_MMAP_MAX
            libc.mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD
    if options.threads > 0:
        torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
