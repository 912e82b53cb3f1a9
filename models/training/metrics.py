"""Figures that tell candidate networks apart without the simulator; postures scaled, rms over joints."""

from dataclasses import replace

import torch
from torch import Tensor

from models.data.sequences import Batch, SequencePack, errors, make_batch, run
from models.networks.rnn import RecurrentNetwork

LOOP_FROM, REST = 40, 10  # tick from which the loop is closed; ticks of rest looked at after the sequence's end
START_TICKS = 10
BEHIND, AHEAD = 2, 6  # ticks about the present one among which a rollout looks for the picture that fits its posture


def _rms(squares: Tensor, weight: Tensor, joints: int) -> float:
    """squares (T, B, n) of the first joints, mean over ticks with weight (T, B)."""
    return float(((squares[..., :joints].mean(-1) * weight).sum() / weight.sum()).sqrt())


@torch.inference_mode()
def validate(rnn: RecurrentNetwork, pack: SequencePack, joints: int) -> dict[str, float]:
    """Validation of a network on clean sequences.

    Returns:
        open: error of the posture, inputs from the data; feature: of the features.
        auto: error of the posture on own predictions from tick 40 to the end; rest: the same in 10 ticks after the end.
        start: share of the demonstrated path (5th percentile) gone after 10 ticks, from rest with a picture that stands
            still, the worse of c_0 and the final states of other sequences: near 0 is a network that stalls.
        follow: distance to the demonstrated path, and done: share of sequences brought to their end, in a rollout in
            which the arm goes where predicted, the picture is the demonstration's that fits the posture best, and the
            fingers go with it.
    """
    device = rnn.output.weight.device
    batch = make_batch(pack, joints, None, torch.Generator()).to(device)
    with device:  # what is made from now on lies there
        return _figures(rnn, batch, joints)


def _figures(rnn: RecurrentNetwork, batch: Batch, joints: int) -> dict[str, float]:
    state = rnn.initial_state(batch.x.shape[1])
    y, states = run(rnn, batch, state)
    posture, feature = errors(y, batch)
    valid = batch.valid[: len(y)]
    result = {
        "open": _rms(posture, valid, joints),
        "feature": float(((feature.mean(-1) * valid).sum() / valid.sum()).sqrt()),
    }
    final = states[batch.last, torch.arange(states.shape[1])]
    result |= _autonomous(rnn, batch, joints)
    result["start"] = min(_start(rnn, batch, joints, s) for s in (state, final.roll(1, 0)))
    return result | _rollout(rnn, batch, joints)


def _autonomous(rnn: RecurrentNetwork, batch: Batch, joints: int) -> dict[str, float]:
    ticks, k = len(batch.x), torch.arange(len(batch.x))[:, None]
    closed = (k >= LOOP_FROM).expand(ticks, batch.x.shape[1])
    looped = replace(batch, closed=closed[..., None], last=torch.full_like(batch.last, ticks - 1))
    y, _ = run(rnn, looped, rnn.initial_state(batch.x.shape[1]))
    posture, _ = errors(y, looped)
    after = ((k > batch.last) & (k <= batch.last + REST)).float()
    return {"auto": _rms(posture, batch.valid * closed, joints), "rest": _rms(posture, after, joints)}


def _start(rnn: RecurrentNetwork, batch: Batch, joints: int, state: Tensor) -> float:
    x = batch.x[0].clone()
    for _ in range(START_TICKS):
        y, state = rnn.step(x, state)
        x[:, :joints] = y[:, :joints]
    first = batch.clean[0, :, :joints]
    wanted, gone = batch.clean[START_TICKS, :, :joints] - first, x[:, :joints] - first
    return float(((wanted * gone).sum(1) / wanted.square().sum(1).clamp_min(1e-9)).quantile(0.05))


def _rollout(rnn: RecurrentNetwork, batch: Batch, joints: int) -> dict[str, float]:
    count = batch.x.shape[1]
    column, window = torch.arange(count), torch.arange(-BEHIND, AHEAD + 1)[:, None]
    arm, state, phase = batch.clean[0, :, :joints], rnn.initial_state(count), torch.zeros(count, dtype=torch.long)
    distances = []
    for _ in range(len(batch.x)):
        near = torch.minimum((phase + window).clamp_min(0), batch.last)
        distance = (batch.clean[near, column, :joints] - arm).square().mean(-1)
        least = distance.min(0)
        phase = near[least.indices, column]
        distances.append(least.values)
        y, state = rnn.step(torch.cat((arm, batch.x[phase, column, joints:]), 1), state)
        arm = y[:, :joints]
    done = phase >= batch.last - 15
    return {"follow": float(torch.stack(distances).mean().sqrt()), "done": float(done.float().mean())}
