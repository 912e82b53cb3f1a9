"""The trained networks as plain numpy functions: what the systems use. One thread, batch 1, deterministic."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from models.files.quantisation import SCALE
from models.files.weights import WeightsError, file_hash, load_autoencoder, load_policy, read_autoencoder
from models.networks.cae import CHANNELS, FEATURE_SIZE, IMAGE_SIZE, to_image


class _FoldedConvolution:
    """Convolution, batch norm and ReLU as one; the weights lie as the CPU's convolution wants them at batch 1."""

    def __init__(self, convolution: torch.nn.Conv2d, norm: torch.nn.BatchNorm2d, size: int) -> None:
        gain, self.bias = _fold(norm)
        weight = convolution.weight * gain[:, None, None, None]
        self.packed = torch.backends.mkldnn.is_available()
        if self.packed:
            shape = [1, weight.shape[1], size, size]
            weight = torch.ops.mkldnn._reorder_convolution_weight(weight, [1, 1], [2, 2], [1, 1], 1, shape)
        self.weight = weight

    def __call__(self, x: Tensor) -> Tensor:
        if not self.packed:
            return F.conv2d(x, self.weight, self.bias, 2, 1).relu_()
        return torch.ops.mkldnn._convolution_pointwise(
            x, self.weight, self.bias, [1, 1], [2, 2], [1, 1], 1, "relu", [], ""
        )


class _SparseFull:
    """The large full layer (18432 -> 1000) as a sum of the rows whose input is not zero, straight from 8 bits.

    At batch 1 the layer costs what its weights cost to read: float32 is 74 MB. ReLU zeroes about half of the inputs,
    and a row of 8-bit weights is a quarter, so that a tenth is read. Sums are float32, as in the dense layer.
    The columns lie in strips of 64, a cache line of each row: the kernel goes over a wide row in several passes.
    """

    STRIP = 64

    def __init__(self, weight: Tensor, scale: Tensor, norm: torch.nn.BatchNorm1d) -> None:
        gain, self.bias = _fold(norm)
        self.gain = scale * gain
        self.columns, rows = weight.shape
        strips = -(-self.columns // self.STRIP)
        # Inputs in the order of a channels-last picture; each row of a strip ends in float32 scale 1 and offset -128.
        order = torch.arange(rows).view(CHANNELS[2], -1).t().reshape(-1)
        padded = torch.full((strips * self.STRIP, rows), 128, dtype=torch.uint8)
        padded[: self.columns] = (weight[:, order].to(torch.int16) + 128).to(torch.uint8)
        self.table = torch.empty(strips, rows, self.STRIP + 8, dtype=torch.uint8)
        self.table[..., : self.STRIP] = padded.view(strips, self.STRIP, rows).transpose(1, 2)
        self.table[..., self.STRIP :] = torch.tensor([1.0, -128.0]).view(torch.uint8)
        self.table = self.table.view(strips * rows, -1)
        self.first_rows = rows * torch.arange(strips)[:, None]

    def __call__(self, x: Tensor) -> Tensor:
        flat = x.permute(0, 2, 3, 1).reshape(-1)
        active = torch.nonzero(flat).squeeze(1)
        strips = len(self.first_rows)
        rows, offsets = (self.first_rows + active).view(-1), len(active) * torch.arange(strips)
        total = torch.ops.quantized.embedding_bag_byte_rowwise_offsets(
            self.table, rows, offsets, False, 0, False, flat[active].repeat(strips), None, False
        )
        return torch.addcmul(self.bias, total.view(1, -1)[:, : self.columns], self.gain)


def _fold(norm: Any) -> tuple[Tensor, Tensor]:
    """Batch norm in eval mode as gain (n,) and bias (n,)."""
    gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
    return gain, norm.bias - norm.running_mean * gain


class Encoder:
    """Image to features, on the stored weights of an autoencoder file.

    Attributes:
        feature_size: 30.
        hash: SHA-256 of the file.
    """

    feature_size = FEATURE_SIZE

    def __init__(self, path: str | Path) -> None:
        self.hash = file_hash(path)
        self._model, _ = load_autoencoder(path)
        stored = read_autoencoder(path)[0]
        layers: Any = self._model.encoder
        with torch.no_grad():
            self._convolutions = [
                _FoldedConvolution(getattr(layers, f"conv{i}"), getattr(layers, f"conv{i}_norm"), n)
                for i, n in enumerate((IMAGE_SIZE, 55, 26))
            ]
            full = "encoder.full.weight"
            self._full = _SparseFull(stored[full], stored[full + SCALE], layers.full_norm)
            gain, self._bias = _fold(layers.feature_norm)
            self._weight = layers.feature.weight * gain[:, None]
        self._activation = layers.feature_activation
        self._model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """uint8 (112, 112, 3) to features, float64 (30,)."""
        _check(rgb, 3)
        with torch.inference_mode():
            x = to_image(torch.from_numpy(np.ascontiguousarray(rgb))[None])
            for convolution in self._convolutions:
                x = convolution(x)
            feature = self._activation(F.linear(self._full(x).relu_(), self._weight, self._bias))
        return feature[0].double().numpy()

    def encode_batch(self, rgb: np.ndarray, batch: int = 64) -> np.ndarray:
        """uint8 (B, 112, 112, 3) to features, float64 (B, 30); equal to encode up to float32 rounding."""
        _check(rgb, 4)
        with torch.inference_mode():
            parts = [
                self._model.encode(to_image(torch.from_numpy(np.ascontiguousarray(rgb[i : i + batch]))))
                for i in range(0, len(rgb), batch)
            ]
        return torch.cat(parts).double().numpy() if parts else np.empty((0, FEATURE_SIZE))


def _check(rgb: np.ndarray, ndim: int) -> None:
    shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
    if rgb.dtype != np.uint8 or rgb.ndim != ndim or rgb.shape[-3:] != shape:
        raise ValueError(f"the encoder takes uint8 pictures {shape}, not {rgb.dtype} {rgb.shape}")


class Policy:
    """Recurrent network and recall heads of a policy file; everything scaled but initial_posture and scaling's bounds.

    Attributes:
        hash: SHA-256 of the file; name: of the network.
        posture_size, feature_size, state_size, horizon: 8, 30, S, N.
        initial_state: c_0 (S,).
        scaling, initial_posture, regulator_gain, encoder_hash, mean_errors, reference_errors, beta, gamma, metadata:
            see StoredPolicy.
    """

    def __init__(self, path: str | Path) -> None:
        self.hash = file_hash(path)
        stored = load_policy(path)
        if stored.recall is None:
            remedy = f"Train them: `python -m models.training recall --policy {path}`"
            raise WeightsError(path, "is a candidate without recall heads", remedy)
        self._rnn, self._heads = stored.rnn, stored.recall
        self.name = stored.rnn.name
        self.posture_size, self.feature_size = stored.rnn.posture_size, stored.rnn.feature_size
        self.state_size, self.horizon = stored.rnn.state_size, stored.recall.horizon
        self.initial_state = np.zeros(self.state_size)
        self.scaling, self.initial_posture = stored.scaling, stored.initial_posture
        self.regulator_gain, self.encoder_hash = stored.regulator_gain, stored.encoder_hash
        self.mean_errors, self.reference_errors = stored.mean_errors, stored.reference_errors
        self.beta, self.gamma = stored.beta, stored.gamma
        self.metadata = stored.metadata

    def step(self, x: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One tick: x (38,) scaled [m_k, f_k], c_{k-1} (S,) to y (38,), the prediction of k+1, unclipped, and c_k."""
        with torch.inference_mode():
            y, after = self._rnn.step(_row(x), _row(state))
        return y[0].double().numpy(), after[0].double().numpy()

    def recall(self, state: np.ndarray) -> np.ndarray:
        """c_k (S,) to recalled postures (N, 8), row n - 1 is m_{k-n}."""
        with torch.inference_mode():
            return self._heads(_row(state))[0].double().numpy()


def _row(x: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(x, np.float32))[None]
