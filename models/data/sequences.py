"""Subtask sequences as padded tensors, the augmentation of their inputs, and the run of a network over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.data.demonstrations import Demonstration, subtask_ranges
from models.data.scaling import MinMaxScaling
from models.networks.rnn import RecurrentNetwork


@dataclass
class SequencePack:
    """n subtask sequences, padded with their last tick; scaled, float32.

    Attributes:
        posture: (n, L, 8) clean m_k; feature: (n, L, 30) clean f_k.
        posture_target: (n, L, 8) m_{k+1}; feature_target: (n, L, 30) f_{k+1}.
        length: (n,) ticks before the padding.
        subtask: (n,) 0 or 1.
    """

    posture: Tensor
    feature: Tensor
    posture_target: Tensor
    feature_target: Tensor
    length: Tensor
    subtask: Tensor

    def pick(self, index: Tensor) -> SequencePack:
        """The sequences at index (B,)."""
        return SequencePack(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def pack_sequences(
    demos: list[Demonstration],
    features: dict[str, np.ndarray],
    scaling: MinMaxScaling,
    target: str = "posture",
    padding: int = 0,
) -> SequencePack:
    """Cuts demonstrations into trimmed subtasks; each gets `padding` ticks of rest after its end.

    Args:
        demos: demonstrations.
        features: features (T, 30) by the demonstration's name.
        scaling: of the posture.
        target: "posture": m_{k+1} as measured; "action": as commanded at k.
        padding: extra ticks after the longest sequence.
    """
    rows: list[tuple[Demonstration, int, int, int, int]] = []
    for demo in demos:
        ends = [*demo.subtask_starts[1:], len(demo.posture)]
        for subtask, (start, stop) in enumerate(subtask_ranges(demo)):
            rows.append((demo, start, stop, ends[subtask] - 1, subtask))
    longest = max(stop - start for _, start, stop, _, _ in rows) + padding
    parts: list[list[np.ndarray]] = [[], [], [], []]
    for demo, start, stop, last, _ in rows:
        now = np.minimum(np.arange(start, start + longest), stop - 1)
        after = np.minimum(np.minimum(np.arange(start, start + longest), stop - 1) + 1, last)
        posture = scaling.scale(demo.posture)
        commanded = scaling.scale(demo.actions)[now] if target == "action" else posture[after]
        for part, value in zip(
            parts, (posture[now], features[demo.name][now], commanded, features[demo.name][after]), strict=True
        ):
            part.append(value)
    m, f, m_next, f_next = (torch.from_numpy(np.stack(part)).float() for part in parts)
    return SequencePack(
        m,
        f,
        m_next,
        f_next,
        length=torch.tensor([stop - start for _, start, stop, _, _ in rows]),
        subtask=torch.tensor([row[-1] for row in rows]),
    )


@dataclass(kw_only=True)
class Augmentation:
    """How the inputs of a training sequence are disturbed while its targets stay clean; scaled units, ticks.

    Args:
        joint_noise: std of the slow noise on the joints (Gaussian knots, linear between them).
        knot_ticks: ticks between knots.
        finger_noise: std of slow noise on the finger. Its measured opening is its own last command: a network that copies it
            lets it drift, and drops the can.
        feature_noise: std of white noise on the features.
        feature_slow_noise: std of slow noise on the features.
        quiet_probability: share of sequences without noise on the joints, and of those without on the features.
        closed_finger_probability: share of the first subtask's sequences that start with the finger seen closed.
        loop_probability: share of sequences with one stretch on the network's own predictions (Eqs. 7, 8, alpha = 1).
        loop_to_end_probability: share of those stretches that go on to the end of the sequence.
        hold_probability: share of those stretches before which the inputs stand still, as when the arm is stopped.
        hold_ticks: longest such standstill.
        rest_ticks: longest rest, still on own predictions, after a stretch that goes to the end.
        carry_ticks: a later sequence may start from the state of any of the last so many ticks of the subtask, or of the rest.
            When a recovery ends, the recall fits as soon as it reaches back to the arrival at home only, long before the
            imagined subtask is at rest.
    """

    joint_noise: float = 0.08
    knot_ticks: int = 12
    finger_noise: float = 0.4
    feature_noise: float = 0.12
    feature_slow_noise: float = 0.3
    quiet_probability: float = 0.2
    closed_finger_probability: float = 0.2
    loop_probability: float = 0.4
    loop_to_end_probability: float = 0.6
    hold_probability: float = 0.8
    hold_ticks: int = 24
    rest_ticks: int = 30
    carry_ticks: int = 9


@dataclass
class Batch:
    """What one run over sequences needs, time first.

    Attributes:
        x: (T, B, 38) inputs; closed: (T, B, 1) bool, where the own prediction takes their place.
        target: (T, B, 38) [m_{k+1}, f_{k+1}]; pull: (T, B, 8) m_k - m_init that the regulator sees.
        clean: (T, B, 8) clean m_k; valid: (T, B) 1 where a tick counts; last: (B,) index of the last valid tick;
        carry: (B,) index of the tick whose state a later sequence may start from.
    """

    x: Tensor
    closed: Tensor
    target: Tensor
    pull: Tensor
    clean: Tensor
    valid: Tensor
    last: Tensor
    carry: Tensor


def slow_noise(ticks: int, batch: int, size: int, every: int, generator: torch.Generator) -> Tensor:
    """(T, B, n): standard normal knots every so many ticks at a random phase, linear between them."""
    knots = torch.randn(ticks // every + 3, batch, size, generator=generator)
    t = torch.arange(ticks)[:, None] / every + torch.rand(1, batch, generator=generator)
    index = t.long()
    part = (t - index)[..., None]
    column = torch.arange(batch)
    return knots[index, column] * (1.0 - part) + knots[index + 1, column] * part


def make_batch(
    pack: SequencePack, initial: Tensor, joints: int, options: Augmentation | None, generator: torch.Generator
) -> Batch:
    """Time-first batch of a pack (all its sequences), augmented unless options is None.

    Args:
        initial: scaled initial posture (8,).
        joints: components that the regulator pulls and the joint noise moves; the rest is the finger.
    """
    batch, ticks = pack.posture.shape[:2]
    clean, feature = pack.posture.transpose(0, 1), pack.feature.transpose(0, 1)
    posture = clean.clone()
    k = torch.arange(ticks)[:, None]
    length = pack.length.clone()
    closed = torch.zeros(ticks, batch, dtype=torch.bool)
    held = k.expand(ticks, batch)
    carry = length - 1

    def chance(probability: float) -> Tensor:
        return torch.rand(batch, generator=generator) < probability

    if options is not None:
        loud = (~chance(options.quiet_probability)).float()[:, None]
        noise = slow_noise(ticks, batch, joints, options.knot_ticks, generator)
        posture[..., :joints] += options.joint_noise * loud * noise
        noise = slow_noise(ticks, batch, posture.shape[-1] - joints, options.knot_ticks, generator)
        posture[..., joints:] += options.finger_noise * loud * noise
        loud = (~chance(options.quiet_probability)).float()[:, None]
        feature = feature + loud * (
            options.feature_noise * torch.randn(feature.shape, generator=generator)
            + options.feature_slow_noise * slow_noise(ticks, batch, feature.shape[-1], options.knot_ticks, generator)
        )
        # After a recovery the finger may still be closed on nothing: it has to open again.
        until = torch.randint(1, 5, (batch,), generator=generator)
        shut = chance(options.closed_finger_probability) & (pack.subtask == 0) & (k < until)
        grip = clean[length - 1, torch.arange(batch), joints:]
        posture[..., joints:] = torch.where(shut[..., None], grip, posture[..., joints:])

        loop, to_end = chance(options.loop_probability), chance(options.loop_to_end_probability)
        share = torch.rand(3, batch, generator=generator)
        start = 1 + (share[0] * (length - 21).clamp_min(1)).long()
        stop = torch.where(to_end, ticks, start + 20 + (share[1] * (length - start - 20).clamp_min(1)).long())
        closed = loop & (k >= start) & (k < stop)
        rest = torch.randint(0, options.rest_ticks + 1, (batch,), generator=generator)
        length = torch.where(loop & to_end, torch.clamp(length + rest, max=ticks), length)
        carried = torch.rand(batch, generator=generator) * (length - pack.length + options.carry_ticks)
        carry = length - 1 - carried.long()
        hold = (2 + share[2] * (options.hold_ticks - 1)).long() * (loop & chance(options.hold_probability))
        onset = (start - hold).clamp_min(0)
        held = torch.where((k >= onset) & (k < start), onset, k)
    column = torch.arange(batch)
    posture, feature = posture[held, column], feature[held, column]
    seen = torch.where(closed[..., None], clean, posture)
    pull = torch.zeros_like(seen)
    pull[..., :joints] = seen[..., :joints] - initial[:joints]
    return Batch(
        x=torch.cat((posture, feature), -1),
        closed=closed[..., None],
        target=torch.cat((pack.posture_target, pack.feature_target), -1).transpose(0, 1),
        pull=pull,
        clean=clean,
        valid=(k < length).float(),
        last=length - 1,
        carry=carry,
    )


def run(rnn: RecurrentNetwork, batch: Batch, state: Tensor) -> tuple[Tensor, Tensor]:
    """Runs the network over a batch from state (B, S): y (T, B, 38) and states (T, B, S)."""
    ticks = int(batch.last.max()) + 1
    return rnn(batch.x[:ticks], batch.closed[:ticks], state)


def errors(y: Tensor, batch: Batch, gain: float) -> tuple[Tensor, Tensor]:
    """Squared errors of the command y - K (m - m_init) (T, B, 8) (Eq. 3, alpha = 0) and of the features (T, B, 30)."""
    size = batch.clean.shape[-1]
    ticks = len(y)
    command = y[..., :size] - gain * batch.pull[:ticks]
    target = batch.target[:ticks]
    return (command - target[..., :size]).square(), (y[..., size:] - target[..., size:]).square()
