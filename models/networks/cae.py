"""The convolutional autoencoder of Table I."""

from collections import OrderedDict
from typing import Any

from torch import Tensor, nn

from models.errors import InputError

IMAGE_SIZE = 112
FEATURE_SIZE = 30
CHANNELS = (32, 64, 128)
HIDDEN = 1000
_KERNEL: dict[str, Any] = {"kernel_size": 6, "stride": 2}
_ACTIVATIONS = {"tanh": nn.Tanh, "relu": nn.ReLU}
Layers = list[tuple[str, nn.Module]]


def _block(name: str, layer: Any, activation: str = "relu") -> Layers:
    """A layer without bias, as the batch norm that follows has its own offset, and the activation."""
    flat = isinstance(layer, nn.Linear)
    norm = nn.BatchNorm1d(layer.out_features) if flat else nn.BatchNorm2d(layer.out_channels)
    return [(name, layer), (f"{name}_norm", norm), (f"{name}_activation", _ACTIVATIONS[activation]())]


class ConvolutionalAutoencoder(nn.Module):
    """112x112 RGB to 30 features and back (Table I: kernel 6, stride 2, padding 1, 32-64-128, full 1000-30-1000).

    Sizes: 112 -> 55 -> 26 -> 12 in the encoder, 12 -> 26 -> 54 -> 112 in the decoder. The last deconvolution has no
    padding: with padding 1 the picture would come out as 110.

    Args:
        feature_activation: "tanh" bounds the features to [-1, 1] and lets none die; "relu" is the paper's.
    """

    def __init__(self, feature_activation: str = "tanh") -> None:
        super().__init__()
        if feature_activation not in _ACTIVATIONS:
            raise InputError(
                f"there is no feature activation {feature_activation!r}: choose one of {sorted(_ACTIVATIONS)}"
            )
        self.feature_activation = feature_activation
        down, up, flat = (3, *CHANNELS), CHANNELS[::-1], CHANNELS[2] * 12 * 12
        encoder: Layers = []
        for i in range(3):
            encoder += _block(f"conv{i}", nn.Conv2d(down[i], down[i + 1], padding=1, bias=False, **_KERNEL))
        encoder.append(("flatten", nn.Flatten()))
        encoder += _block("full", nn.Linear(flat, HIDDEN, bias=False))
        encoder += _block("feature", nn.Linear(HIDDEN, FEATURE_SIZE, bias=False), feature_activation)
        decoder = _block("full0", nn.Linear(FEATURE_SIZE, HIDDEN, bias=False))
        decoder += _block("full1", nn.Linear(HIDDEN, flat, bias=False))
        decoder.append(("unflatten", nn.Unflatten(1, (CHANNELS[2], 12, 12))))
        for i in range(2):
            decoder += _block(f"deconv{i}", nn.ConvTranspose2d(up[i], up[i + 1], padding=1, bias=False, **_KERNEL))
        # The picture itself is linear: ReLU has no gradient where a pixel is predicted too dark, and batch norm would
        # make the colour of one picture depend on the others in its batch.
        decoder.append(("output", nn.ConvTranspose2d(up[2], 3, padding=0, **_KERNEL)))
        self.encoder = nn.Sequential(OrderedDict(encoder))
        self.decoder = nn.Sequential(OrderedDict(decoder))

    def encode(self, image: Tensor) -> Tensor:
        """Images (B, 3, 112, 112) in [0, 1] to features (B, 30)."""
        return self.encoder(image)

    def decode(self, feature: Tensor) -> Tensor:
        """Features (B, 30) to images (B, 3, 112, 112)."""
        return self.decoder(feature)


def to_image(rgb: Tensor) -> Tensor:
    """uint8 (B, 112, 112, 3) to float (B, 3, 112, 112) in [0, 1]; the memory stays as it lies (channels last)."""
    return rgb.permute(0, 3, 1, 2).float().div_(255.0)
