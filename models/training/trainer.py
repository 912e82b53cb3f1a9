"""What the three trainings share: options, batches that depend on (seed, step) alone, checkpoints, the Trainer."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import Callback, TQDMProgressBar
from lightning.pytorch.loggers import CSVLogger
from torch.utils.data import DataLoader, IterableDataset


@dataclass(kw_only=True)
class TrainingOptions:
    """Options of every training.

    Args:
        data: data set of diagrams/teach.py (HDF5).
        out: folder for checkpoints, logs and weight files; a training found there is resumed.
        seed: draws initial weights, batches and augmentation.
        threads: threads of torch; 0 leaves torch's choice.
        accelerator: "auto" takes a GPU if there is one.
        progress: show a progress bar.
    """

    data: Path
    out: Path
    seed: int = 0
    threads: int = 0
    accelerator: str = "auto"
    progress: bool = True

    def as_metadata(self) -> dict[str, Any]:
        """The options for a weight file, without what belongs to this machine."""
        skip = {"data", "out", "threads", "progress", "accelerator", "encoder", "features", "policy", "start_from"}
        return {key: value for key, value in asdict(self).items() if key not in skip}


def step_generator(seed: int, step: int) -> torch.Generator:
    """A random generator for one update: a resumed training draws what an unbroken one would have drawn."""
    return torch.Generator().manual_seed(seed * 1_000_003 + step)


class StepBatches(IterableDataset):
    """Yields make(step) for step = start..stop - 1; its length counts from 0, as Lightning's resumed loop does."""

    def __init__(self, make: Callable[[int], Any], start: int, stop: int) -> None:
        self.make, self.start, self.stop = make, start, stop

    def __len__(self) -> int:
        return self.stop

    def __iter__(self) -> Iterator[Any]:
        return (self.make(step) for step in range(self.start, self.stop))


class StepModule(lightning.LightningModule):
    """A LightningModule trained for `steps` updates; subclasses give make_batch(step), training_step and export.

    Learning rate: cosine from learning_rate to final_rate.
    """

    def __init__(self, steps: int, learning_rate: float, final_rate: float) -> None:
        super().__init__()
        self.steps, self.learning_rate, self.final_rate = steps, learning_rate, final_rate

    def make_batch(self, step: int) -> Any:
        """The batch of one update, by (seed, step) alone."""
        raise NotImplementedError

    def export(self, step: int, final: bool) -> None:
        """Writes weight files at a checkpoint."""

    def train_dataloader(self) -> DataLoader:
        """Batches from the present update on."""
        return DataLoader(StepBatches(self.make_batch, self.trainer.global_step, self.steps), batch_size=None)

    def configure_optimizers(self) -> Any:
        """Adam (0.9, 0.999) with cosine decay, stepped every update."""
        parameters = [parameter for parameter in self.parameters() if parameter.requires_grad]
        optimizer = torch.optim.Adam(parameters, self.learning_rate, (0.9, 0.999), fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(self.steps, 1), self.final_rate)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


class Checkpoint(Callback):
    """Every `every` updates: DIR/last.ckpt, replaced in one go so that a kill never leaves half a file, and export."""

    def __init__(self, path: Path, every: int) -> None:
        self.path, self.every = path, every

    def on_train_batch_end(self, trainer: Any, module: Any, *_: Any) -> None:
        """Lightning's hook after each update."""
        if trainer.global_step % self.every == 0 and trainer.global_step < module.steps:
            self._write(trainer, module, final=False)

    def on_train_end(self, trainer: Any, module: Any) -> None:
        """Lightning's hook at the end."""
        if trainer.global_step >= module.steps:
            self._write(trainer, module, final=True)

    def _write(self, trainer: Any, module: Any, final: bool) -> None:
        partial = self.path.with_suffix(".part")
        trainer.save_checkpoint(partial)
        os.replace(partial, self.path)
        module.export(trainer.global_step, final)


def fit(
    module: StepModule,
    options: TrainingOptions,
    checkpoint_every: int,
    clip: float | None = None,
    log_every: int = 50,
    name: str = "last",
) -> None:
    """Trains to module.steps, from DIR/NAME.ckpt if there is one; metrics go to DIR/logs."""
    checkpoint = options.out / f"{name}.ckpt"
    callbacks: list[Callback] = [Checkpoint(checkpoint, checkpoint_every)]
    if options.progress:
        callbacks.append(TQDMProgressBar(refresh_rate=10))
    trainer = lightning.Trainer(
        accelerator=options.accelerator,
        devices=1,
        max_steps=module.steps,
        max_epochs=-1,
        callbacks=callbacks,
        logger=CSVLogger(options.out, name="logs", flush_logs_every_n_steps=log_every),
        log_every_n_steps=min(log_every, module.steps),
        enable_checkpointing=False,
        enable_progress_bar=options.progress,
        enable_model_summary=False,
        gradient_clip_val=clip,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
    )
    trainer.fit(module, ckpt_path=checkpoint if checkpoint.is_file() else None)


def keep_freed_memory() -> None:
    """Has glibc keep large freed blocks: handing them back to the kernel after every update costs time."""
    if sys.platform == "linux":
        try:
            libc = ctypes.CDLL("libc.so.6")
        except OSError:  # another C library: only slower
            return
        libc.mallopt(-4, 0)  # M_MMAP_MAX
        libc.mallopt(-1, 2**31 - 1)  # M_TRIM_THRESHOLD


def prepare(options: TrainingOptions) -> None:
    """The output folder, threads, seed, and the quirks of Lightning that tell a user nothing."""
    options.out.mkdir(parents=True, exist_ok=True)
    keep_freed_memory()
    warnings.filterwarnings(
        "ignore",
        "(?s).*(isinstance\\(treespec|IterableDataset|resuming from a checkpoint|does not have many workers).*",
    )
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    if options.threads > 0:
        torch.set_num_threads(options.threads)
    lightning.seed_everything(options.seed, verbose=False)
