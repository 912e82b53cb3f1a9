"""Subtask sequences as padded tensors, batches of them, and the run of a network over a batch."""

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from models.data.augmentation import Augmentation, augment
from models.data.demonstrations import Demonstration, subtask_ranges
from models.data.scaling import MinMaxScaling
from models.errors import InputError


@dataclass
class SequencePack:
    """n subtask sequences, padded with their last tick; scaled, float32.

    Attributes:
        x: (n, L, 38) clean [m_k, f_k]; target: (n, L, 38) [m_{k+1}, f_{k+1}].
        length: (n,) ticks before the padding.
        posture_size: components of a posture.
    """

    x: Tensor
    target: Tensor
    length: Tensor
    posture_size: int

    def pick(self, index: Tensor) -> Self:
        """The sequences at index (B,)."""
        return type(self)(self.x[index], self.target[index], self.length[index], self.posture_size)


def pack_sequences(
    demos: list[Demonstration], features: dict[str, np.ndarray], scaling: MinMaxScaling, target: str, padding: int
) -> SequencePack:
    """Cuts demonstrations into trimmed subtasks; the longest gets `padding` ticks of rest after its end.

    `features`: (T, 30) by the demonstration's name; `target`: m_{k+1} as measured ("posture") or commanded ("action").
    """
    if not demos:
        raise InputError("a split has no demonstration: teach more (diagrams/teach.py with a larger --limit)")
    cuts = []
    for demo in demos:
        ends = [*demo.subtask_starts[1:], len(demo.posture)]
        ranges = zip(subtask_ranges(demo), ends, strict=True)
        cuts += [(demo, start, stop, end - 1) for (start, stop), end in ranges]
    ticks = np.arange(max(stop - start for _, start, stop, _ in cuts) + padding)
    rows = []
    for demo, start, stop, last in cuts:
        now = np.minimum(start + ticks, stop - 1)
        after = np.minimum(now + 1, last)
        posture, feature = scaling.scale(demo.posture), features[demo.name]
        commanded = scaling.scale(demo.actions)[now] if target == "action" else posture[after]
        rows.append((np.hstack((posture[now], feature[now])), np.hstack((commanded, feature[after]))))
    x, wanted = (torch.from_numpy(np.stack(part)).float() for part in zip(*rows, strict=True))
    length = torch.tensor([stop - start for _, start, stop, _ in cuts])
    return SequencePack(x, wanted, length, len(scaling.lower))


@dataclass
class Batch:
    """What one run over sequences needs, time first.

    Attributes:
        x: (T, B, 38) inputs; closed: (T, B, 1) bool, where the own prediction takes their place.
        target: (T, B, 38) [m_{k+1}, f_{k+1}]; clean: (T, B, 8) clean m_k.
        valid: (T, B) 1 where a tick counts; last: (B,) index of the last valid tick;
        carry: (B,) index of the tick whose state a later sequence may start from.
    """

    x: Tensor
    closed: Tensor
    target: Tensor
    clean: Tensor
    valid: Tensor
    last: Tensor
    carry: Tensor

    def to(self, device: torch.device) -> Self:
        """The batch on a device."""
        return type(self)(**{field.name: getattr(self, field.name).to(device) for field in fields(self)})


def make_batch(pack: SequencePack, joints: int, options: Augmentation | None, generator: torch.Generator) -> Batch:
    """Time-first batch of a pack (all its sequences), augmented unless options is None.

    `joints`: components that the joint noise moves, before the finger.
    """
    x, size = pack.x.transpose(0, 1).contiguous(), pack.posture_size
    clean = x[..., :size]
    closed, length, carry = torch.zeros(x.shape[:2], dtype=torch.bool), pack.length, pack.length - 1
    if options is not None:
        x, closed, length, carry = augment(clean, x[..., size:], length, joints, options, generator)
    valid = (torch.arange(len(x))[:, None] < length).float()
    return Batch(x, closed[..., None], pack.target.transpose(0, 1), clean, valid, length - 1, carry)


def run(rnn: Any, batch: Batch, state: Tensor) -> tuple[Tensor, Tensor]:
    """Runs a RecurrentNetwork, or its like, over a batch from state (B, S): y (T, B, 38) and states (T, B, S)."""
    ticks = int(batch.last.max()) + 1
    return rnn(batch.x[:ticks], batch.closed[:ticks], state)


def errors(y: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
    """Squared errors of the posture (T, B, 8) and of the features (T, B, 30) that y (T, B, 38) predicts."""
    size = batch.clean.shape[-1]
    squares = (y - batch.target[: len(y)]).square()
    return squares[..., :size], squares[..., size:]
