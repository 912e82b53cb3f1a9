import torch

from models.networks.recall import RecallHeads
from models.training.recall import recall_targets


def test_shapes_and_the_paper_s_linear_heads() -> None:
    assert RecallHeads(500, 8)(torch.randn(3, 500)).shape == (3, 10, 8)
    linear = RecallHeads(6, 2, horizon=4, hidden=None)
    assert [tuple(p.shape) for p in linear.parameters()] == [(8, 6), (8,)]
    state = torch.randn(1, 6)
    torch.testing.assert_close(linear(2 * state) - linear(state), linear(state) - linear(0 * state))


def test_targets_are_the_postures_before_and_the_first_one_before_the_start() -> None:
    clean = torch.arange(5.0)[:, None, None].expand(5, 1, 1)
    target = recall_targets(clean, 3)[:, 0, :, 0]
    assert target.tolist() == [[0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 1, 0], [3, 2, 1]]
