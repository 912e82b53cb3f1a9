"""Large matrices in 8 bits a weight: NAME int8 beside NAME.row_scale float32 (symmetric per row)."""

import torch
from torch import Tensor

SCALE = ".row_scale"
QUANTISE_FROM = 200_000  # a matrix with more weights than that is stored in 8 bits


def quantise(weight: Tensor) -> tuple[Tensor, Tensor]:
    """W (rows, cols) float to int8 W and float32 scale (rows,), so that W is about int8 * scale."""
    scale = weight.float().abs().amax(1).clamp_min(1e-12) / 127.0
    return torch.round(weight.float() / scale[:, None]).clamp_(-127, 127).to(torch.int8), scale


def dequantise(weight: Tensor, scale: Tensor) -> Tensor:
    """The float32 matrix that an int8 matrix (rows, cols) and its scale (rows,) stand for."""
    return weight.float() * scale[:, None]


def is_large(weight: Tensor) -> bool:
    """Whether it is a matrix that an autoencoder's file keeps in 8 bits."""
    return weight.ndim == 2 and weight.numel() >= QUANTISE_FROM


def rounded(weight: Tensor) -> Tensor:
    """As all other weights are stored: matrices float16, vectors float32."""
    return weight.to(torch.float16 if weight.ndim > 1 else torch.float32).contiguous()
