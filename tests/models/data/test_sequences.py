from dataclasses import replace

import numpy as np
import pytest
import torch

from models.data.augmentation import Augmentation, slow_noise
from models.data.scaling import MinMaxScaling
from models.data.sequences import SequencePack, errors, make_batch, pack_sequences, run
from models.errors import InputError
from tests.models.conftest import make_policy
from tests.models.data.test_demonstrations import demo, ramp

QUIET = Augmentation(
    joint_noise=0, feature_noise=0, feature_slow_noise=0, closed_finger_probability=0, loop_probability=0
)


def random_pack(count: int = 6, length: int = 60, padding: int = 30) -> SequencePack:
    g = torch.Generator().manual_seed(0)
    x = torch.cat([torch.rand(count, length + padding, n, generator=g) for n in (8, 30)], -1)
    return SequencePack(x, x + 0.1, length - 5 + torch.arange(count) % 6, 8)


def test_pack_aligns_targets_one_tick_ahead_and_rests_at_the_end() -> None:
    one = demo(ramp(12, 10, 20), ramp(2, 10, 5))
    one.posture[:] += 1e-4 * np.arange(len(one.posture))[:, None]
    features = {"demo_0": np.arange(len(one.posture))[:, None] * np.ones(30)}
    pack = pack_sequences([one], features, MinMaxScaling(-np.ones(8), np.ones(8)), "posture", 4)
    assert pack.length.tolist() == [26, 17]
    assert pack.posture_size == 8
    assert pack.x[0, :, 8].tolist() == [*range(9, 35), 34, 34, 34, 34]
    assert pack.target[0, :, 8].tolist() == [*range(10, 36), 35, 35, 35, 35]
    assert pack.target[1, 16, 8] == 58  # the very last tick has none after it
    torch.testing.assert_close(pack.x[0, :26, :8], torch.from_numpy(one.posture[9:35]).float())
    torch.testing.assert_close(pack.target[0, :26, :8], torch.from_numpy(one.posture[10:36]).float())


def test_without_augmentation_inputs_are_the_data() -> None:
    pack = random_pack()
    for options in (None, QUIET):
        batch = make_batch(pack, 7, options, torch.Generator().manual_seed(1))
        torch.testing.assert_close(batch.x, pack.x.transpose(0, 1))
        assert not batch.closed.any()
        assert batch.last.tolist() == [54, 55, 56, 57, 58, 59]
        assert batch.valid.sum(0).tolist() == [55, 56, 57, 58, 59, 60]


def test_noise_has_the_asked_size_and_never_touches_targets() -> None:
    pack = random_pack(64)
    options = replace(QUIET, joint_noise=0.08, feature_noise=0.05, quiet_probability=0.0)
    batch = make_batch(pack, 7, options, torch.Generator().manual_seed(1))
    noise = batch.x - pack.x.transpose(0, 1)
    assert not noise[..., 7].any()  # the fingers have two openings, which they take at once
    assert noise[..., :7].std().item() == pytest.approx(0.08 * (2 / 3) ** 0.5, rel=0.1)  # of knots joined by lines
    assert noise[..., 8:].std().item() == pytest.approx(0.05, rel=0.05)
    torch.testing.assert_close(batch.target, pack.target.transpose(0, 1))


def test_some_first_subtasks_start_with_the_fingers_seen_closed() -> None:
    """Those alone that start with open ones, for a share of the sequences and of a few ticks; nothing else changes."""
    pack = random_pack(400)
    fingers = pack.x[:, :, 7]
    fingers[:] = -0.8
    fingers[::2, :30] = 0.8  # a first subtask: open until the grasp
    options = replace(QUIET, closed_finger_probability=0.5, closed_finger_ticks=10)
    batch = make_batch(pack, 7, options, torch.Generator().manual_seed(1))
    changed = batch.x != pack.x.transpose(0, 1)
    assert not changed[..., :7].any()
    assert not changed[..., 8:].any()
    assert not changed[:, 1::2, 7].any()
    ticks = changed[:, ::2, 7].sum(0)
    assert 0.4 < (ticks > 0).float().mean() < 0.6
    assert set(ticks.tolist()) == set(range(11))
    for sequence, count in zip(range(0, 400, 2), ticks.tolist(), strict=True):  # from the first tick on
        assert batch.x[:count, sequence, 7].tolist() == pytest.approx([-0.8] * count)
        assert batch.x[count:30, sequence, 7].tolist() == pytest.approx([0.8] * (30 - count))
    torch.testing.assert_close(batch.clean, pack.x.transpose(0, 1)[..., :8])
    torch.testing.assert_close(batch.target, pack.target.transpose(0, 1))


def test_slow_noise_is_linear_between_its_knots() -> None:
    noise = slow_noise(200, 3, 2, 12, torch.Generator().manual_seed(0))
    bends = (noise[2:] - 2 * noise[1:-1] + noise[:-2]).abs().amax(-1) > 1e-5
    assert (bends.sum(0) <= 2 * (200 // 12 + 1)).all()


def test_loop_stretches_and_rest() -> None:
    pack = random_pack(200)
    options = replace(QUIET, loop_probability=1.0, loop_to_end_probability=0.5)
    batch = make_batch(pack, 7, options, torch.Generator().manual_seed(1))
    closed = batch.closed[..., 0]
    assert closed.any(0).all()
    assert not closed[0].any()
    for b in range(200):
        ticks = torch.nonzero(closed[:, b]).flatten()
        assert (ticks.diff() == 1).all()
        start, stop = int(ticks[0]), int(ticks[-1]) + 1
        to_end = stop == len(closed)
        if not to_end:
            assert stop - start >= 20
            assert batch.last[b] == pack.length[b] - 1
        assert pack.length[b] - 1 <= batch.last[b] <= pack.length[b] - 1 + 30


def test_states_are_carried_over_from_the_end_dwell_or_the_rest() -> None:
    pack = random_pack(400)
    still = make_batch(pack, 7, None, torch.Generator())
    assert torch.equal(still.carry, still.last)
    options = replace(QUIET, loop_probability=0.5, carry_ticks=9)
    batch = make_batch(pack, 7, options, torch.Generator().manual_seed(1))
    back, rest = batch.last - batch.carry, batch.last - (pack.length - 1)
    assert back.min() == 0
    assert torch.all(back <= rest + 8)
    assert set((back - rest).tolist()) >= set(range(9))  # every tick of the dwell's end
    assert (back - rest).min() < -15  # and of the rest


def test_batch_goes_to_a_device_whole() -> None:
    batch = make_batch(random_pack(), 7, QUIET, torch.Generator().manual_seed(1))
    assert {value.device.type for value in vars(batch.to(torch.device("meta"))).values()} == {"meta"}


def test_run_closes_the_loop_on_the_clipped_prediction() -> None:
    rnn, pack = make_policy().rnn, random_pack(2, 25, 0)
    batch = make_batch(pack, 7, None, torch.Generator())
    batch.closed[10:15, 1] = True
    with torch.no_grad():
        rnn.output.bias[0] = 5.0
        y, states = run(rnn, batch, rnn.initial_state(2))
        state = rnn.initial_state(2)
        wanted = batch.x[0]
        for k in range(len(y)):
            x = batch.x[k].clone()
            if 10 <= k < 15:
                x[1] = wanted.clip(-1, 1)[1]
            wanted, state = rnn.step(x, state)
            torch.testing.assert_close(y[k], wanted)
    torch.testing.assert_close(states[-1], state)


def test_errors_are_those_of_the_posture_and_of_the_features() -> None:
    batch = make_batch(random_pack(2), 7, None, torch.Generator())
    posture, feature = errors(torch.full((5, 2, 38), 0.2), batch)
    torch.testing.assert_close(posture, (0.2 - batch.target[:5, :, :8]).square())
    torch.testing.assert_close(feature, (0.2 - batch.target[:5, :, 8:]).square())


def test_a_split_without_a_demonstration_is_named() -> None:
    with pytest.raises(InputError, match="a split has no demonstration: teach more"):
        pack_sequences([], {}, MinMaxScaling(np.zeros(8), np.ones(8)), "action", 0)
