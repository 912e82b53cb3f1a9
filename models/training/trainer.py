"""What the trainings share: options and the loop over updates.

A plain loop, no Lightning: it is shorter than what bent its Trainer to batches by (seed, step) and one checkpoint.
"""

import csv
import ctypes
import math
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from tqdm import tqdm

from models.checks import LARGEST_SEED, require_plain
from models.errors import InputError
from models.files.container import locked, naming
from models.interrupts import asked, held, leave_if_asked
from models.training.checkpoint import Checkpoint

# Options that name places and this machine: they are not written into weight files.
_LOCAL = {"data", "out", "device", "encoder", "features", "policy", "start_from"}
# Numbers that must be above 0; every other one may be 0.
_POSITIVE = {"steps", "batch_size", "max_images", "horizon", "checkpoint_every", "validate_every", "knot_ticks"}
_POSITIVE |= {"scaling_margin", "least_half_range", "closed_finger_ticks"}
# The most of a number, where that is not MOST: more takes the memory, or no data have it.
MOST = 10**6
LARGEST_LOG = 100_000_000  # bytes
_MOST = {
    "seed": LARGEST_SEED, "steps": 10**8, "max_images": 10**9, "checkpoint_every": 10**8, "validate_every": 10**8,
    "batch_size": 4096, "horizon": 1000, "hidden": 10_000, "rest_ticks": 1000, "carry_ticks": 1000, "shift": 100,
    "feature_noise": 100, "noise": 100, "joint_noise": 100, "feature_slow_noise": 100, "colour": 100,
    "learning_rate": 100, "final_rate": 100, "scaling_margin": 100, "least_half_range": 100,
}  # fmt: skip


@dataclass(kw_only=True)
class TrainingOptions:
    """Options of every training.

    Args:
        data: data set of diagrams/teach.py (HDF5).
        out: folder for the checkpoint, the log (CSV) and the weight files. The same command goes on with a training
            found there; other options, data or seeds are refused.
        seed: of initial weights, batches and augmentation.
        device: "auto" takes a GPU if there is one; or torch's name of one ("cpu", "cuda"). Batches and noise are drawn
            on the CPU and are the same on each.
    """

    data: Path
    out: Path
    seed: int = 0
    device: str = "auto"

    def __post_init__(self) -> None:
        require_in_range(asdict(self))

    def as_metadata(self) -> dict[str, Any]:
        """The options for a weight file, without what belongs to this machine."""
        return {key: value for key, value in asdict(self).items() if key not in _LOCAL}


def require_in_range(options: dict[str, Any], prefix: str = "--") -> None:
    """Raises InputError for a number that is not finite, negative, 0 in _POSITIVE, too large, or no probability."""
    for name, value in options.items():
        if isinstance(value, dict):
            require_in_range(value, f"{prefix}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            least = int(name in _POSITIVE)
            most = 1 if "probability" in name or name == "carry_over" else _MOST.get(name, MOST)
            low = value <= 0 if least else value < 0
            option = f"{prefix}{name}".replace("_", "-")
            if value > most > 1 and math.isfinite(value):
                raise InputError(f"{option} {value} is too large: choose at most {most}")
            if low or not math.isfinite(value) or value > most:
                words = "above 0" if least else "from 0 to 1" if most == 1 else "0 or more"
                raise InputError(f"{option} {value} is out of range: choose a number {words}")


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


def device_of(options: TrainingOptions) -> str:
    """The name of the device that the options ask for."""
    if options.device != "auto":
        return options.device
    return "cuda" if torch.cuda.is_available() else "cpu"


def require_device(device: str) -> None:
    """Raises InputError for a device that torch does not know, or that cannot compute."""
    try:
        if torch.zeros(1, device=device).item():
            raise RuntimeError("it does not compute")
    except Exception as error:  # torch has a class of its own for each device that is not there
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"--device {device} cannot be used ({reason:.200}): choose auto, or cpu") from error


def step_generator(seed: int, step: int) -> torch.Generator:
    """The random generator of one update."""
    return torch.Generator().manual_seed(seed * 1_000_003 + step)


def fit(
    training: Training, options: Any, made_from: dict[str, str], name: str, clip: float = math.inf, log_every: int = 50
) -> None:
    """Trains to training.steps, from OUT/NAME.ckpt if it is there; logs to OUT/NAME.csv and OUT/NAME-validation.csv.

    Args:
        options: TrainingOptions with checkpoint_every; the training goes to its device, and stays there.
        made_from: hashes of data and weights that the training starts from.
        clip: largest norm of the gradient.
        log_every: updates between rows of the log.

    Raises:
        InputError: the checkpoint is damaged or of another training; the loss or a weight is not finite.
        Interrupted: after Ctrl-C or SIGTERM, with a checkpoint of the last whole update.
    """
    with locked(options.out / f"{name}.lock"):
        try:
            _fit(training, options, made_from, name, clip, log_every)
        except (KeyboardInterrupt, OSError) as end:
            kept = options.out / f"{name}.ckpt"
            if kept.exists():
                end.add_note(f"{kept} keeps what was done: the same command goes on")
            raise


def _fit(training: Training, options: Any, made_from: dict[str, str], name: str, clip: float, log_every: int) -> None:
    training.train().to(device_of(options))
    parameters = [parameter for parameter in training.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(parameters, training.learning_rate, fused=True)
    checkpoint = Checkpoint(options.out / f"{name}.ckpt", training, optimizer, options.as_metadata() | made_from)
    log, validation_log = (options.out / f"{name}{ending}.csv" for ending in ("", "-validation"))
    start, steps = checkpoint.load(), training.steps
    # Both are looked at before anything is changed.
    kept = [(path, _kept_rows(path, start)) for path in (log, validation_log) if path.exists()]
    checkpoint.export_missing()
    for path, length in kept:
        with naming(path):
            os.truncate(path, length)
    if start == steps:
        print(f"{checkpoint.path}: all {start} updates are done")
    bar = tqdm(range(start, steps), initial=start, total=steps, disable=None)
    with held():
        for step in bar:
            optimizer.param_groups[0]["lr"] = training.rate(step)
            loss, figures = training.loss(training.make_batch(step), step)
            if not math.isfinite(loss.item()):
                raise checkpoint.diverged(f"the loss of update {step + 1} is {loss.item()}")
            optimizer.zero_grad()
            loss.backward()
            if clip < math.inf:
                nn.utils.clip_grad_norm_(parameters, clip)
            optimizer.step()
            done = step + 1
            if done % log_every == 0 or done == steps:
                row = {key: value.item() for key, value in figures.items()}
                _add_row(log, {"update": done, "rate": training.rate(step)} | row)
                bar.set_postfix({key: f"{value:.3g}" for key, value in row.items()}, refresh=False)
            if valid := training.validate(done):
                _add_row(validation_log, {"update": done} | valid)
                bar.write(f"update {done}: " + ", ".join(f"{key} {value:.4f}" for key, value in valid.items()))
            due = done % options.checkpoint_every == 0 or done == steps
            if due or asked():
                checkpoint.save(done, export=due)
            if asked() and done < steps:
                bar.close()
                leave_if_asked()


def _add_row(path: Path, row: dict[str, Any]) -> None:
    with naming(path), path.open("a", newline="") as file:
        writer = csv.DictWriter(file, row)
        if not file.tell():
            writer.writeheader()
        writer.writerow(row)


def _kept_rows(path: Path, done: int) -> int:
    """The length of the log in `path`, bytes, without rows of updates beyond `done`, which come once more, and a row
    that was cut off: the last ones. Raises InputError for a file that is no log.
    """
    require_plain(path, "choose another --out", LARGEST_LOG)
    header, *rows = path.read_bytes().splitlines(keepends=True) or [b""]
    try:
        kept = [row for row in rows if row.endswith(b"\n") and int(row.split(b",")[0]) <= done]
    except ValueError as error:
        words = " ".join(str(error).split())
        raise InputError(f"{path} is no log of a training ({words}): delete it, or choose another --out") from error
    return sum(map(len, (header, *kept))) if kept else 0


def prepare(options: TrainingOptions) -> None:
    """The output folder, the device and the seed; large freed blocks of memory are kept.

    Raises InputError for a folder that cannot be made, and a device that there is not.
    """
    require_device(device_of(options))
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{options.out} cannot be made ({error.strerror}): choose another --out") from error
    with suppress(OSError, AttributeError):  # glibc alone has it; another C library is only slower
        # To hand them back to the kernel after every update costs time.
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-4, 0)  # M_MMAP_MAX
        libc.mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD
    torch.manual_seed(options.seed)
