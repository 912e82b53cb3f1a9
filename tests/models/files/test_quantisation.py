import torch

from models.files.quantisation import dequantise, quantise


def test_quantisation_errs_by_half_a_step_at_most_and_is_idempotent() -> None:
    torch.manual_seed(0)
    weight = torch.randn(20, 300) * torch.logspace(-3, 1, 20)[:, None]
    stored, scale = quantise(weight)
    assert stored.dtype == torch.int8
    assert stored.abs().amax(1).eq(127).all()
    assert ((dequantise(stored, scale) - weight).abs() <= 0.5001 * scale[:, None]).all()
    again, scale_again = quantise(dequantise(stored, scale))
    assert torch.equal(again, stored)
    torch.testing.assert_close(scale_again, scale)
