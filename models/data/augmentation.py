"""How the inputs of training sequences are disturbed while their targets stay clean."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(kw_only=True)
class Augmentation:
    """How the inputs of a training sequence are disturbed while its targets stay clean; scaled units, ticks.

    Args:
        joint_noise: std of the slow noise on the joints (Gaussian knots, linear between them).
        knot_ticks: ticks between knots.
        feature_noise: std of white noise on the features.
        feature_slow_noise: std of slow noise on the features.
        quiet_probability: share of sequences without noise on the joints, and of those without on the features.
        closed_finger_probability: share of the sequences that start with open fingers (the first subtask's) that see
            them closed, in the posture alone, for up to closed_finger_ticks: the can may be taken from the hand, and a
            hand that comes home closed has to open.
        closed_finger_ticks: see there.
        loop_probability: share of sequences with one stretch on the network's own predictions (Eqs. 7, 8, alpha = 1).
        loop_to_end_probability: share of those stretches that go on to the end of the sequence.
        rest_ticks: longest rest, still on own predictions, after a stretch that goes to the end.
        carry_ticks: a later sequence may start from the state of any of the last so many ticks of the subtask, or of
            the rest. When a recovery ends, the recall fits as soon as it reaches back to the arrival at home only, long
            before the imagined subtask is at rest.
    """

    joint_noise: float = 0.08
    knot_ticks: int = 12
    feature_noise: float = 0.12
    feature_slow_noise: float = 0.3
    quiet_probability: float = 0.2
    closed_finger_probability: float = 0.2
    closed_finger_ticks: int = 10
    loop_probability: float = 0.4
    loop_to_end_probability: float = 0.6
    rest_ticks: int = 30
    carry_ticks: int = 9


def slow_noise(ticks: int, batch: int, size: int, every: int, generator: torch.Generator) -> Tensor:
    """(T, B, n): standard normal knots every so many ticks at a random phase, linear between them."""
    knots = torch.randn(ticks // every + 3, batch, size, generator=generator)
    t = torch.arange(ticks)[:, None] / every + torch.rand(1, batch, generator=generator)
    index = t.long()
    part = (t - index)[..., None]
    column = torch.arange(batch)
    return knots[index, column] * (1.0 - part) + knots[index + 1, column] * part


def augment(
    clean: Tensor,
    feature: Tensor,
    length: Tensor,
    joints: int,
    options: Augmentation,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Disturbs clean (T, B, 8) and feature (T, B, 30) of sequences with length (B,).

    `joints`: components of a posture before the finger.

    Returns:
        The inputs (T, B, 38); (T, B) bool, where the own prediction takes their place; (B,) ticks that count, those of
        the rest after a sequence included; (B,) index of the tick whose state a later sequence may start from.
    """
    ticks, batch = clean.shape[:2]
    k = torch.arange(ticks)[:, None]

    def chance(probability: float) -> Tensor:
        return torch.rand(batch, generator=generator) < probability

    posture = clean.clone()
    loud = (~chance(options.quiet_probability)).float()[:, None]
    noise = slow_noise(ticks, batch, joints, options.knot_ticks, generator)
    posture[..., :joints] += options.joint_noise * loud * noise
    shut = chance(options.closed_finger_probability) & (clean[0, :, joints] > 0.0)
    until = 1 + torch.randint(0, options.closed_finger_ticks, (batch,), generator=generator)
    posture[..., joints] = torch.where(shut & (k < until), clean[..., joints].min(), posture[..., joints])
    loud = (~chance(options.quiet_probability)).float()[:, None]
    feature = feature + loud * (
        options.feature_noise * torch.randn(feature.shape, generator=generator)
        + options.feature_slow_noise * slow_noise(ticks, batch, feature.shape[-1], options.knot_ticks, generator)
    )

    loop, to_end = chance(options.loop_probability), chance(options.loop_to_end_probability)
    share = torch.rand(2, batch, generator=generator)
    start = 1 + (share[0] * (length - 21).clamp_min(1)).long()
    stop = torch.where(to_end, ticks, start + 20 + (share[1] * (length - start - 20).clamp_min(1)).long())
    closed = loop & (k >= start) & (k < stop)
    rest = torch.randint(0, options.rest_ticks + 1, (batch,), generator=generator)
    longer = torch.where(loop & to_end, torch.clamp(length + rest, max=ticks), length)
    carried = torch.rand(batch, generator=generator) * (longer - length + options.carry_ticks)
    return torch.cat((posture, feature), -1), closed, longer, longer - 1 - carried.long()
