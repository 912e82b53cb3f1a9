import pytest
import torch
from torch import nn

from models.networks.cae import ConvolutionalAutoencoder, to_image


def test_sizes_of_table_one() -> None:
    model = ConvolutionalAutoencoder().eval()
    sizes = []
    for layer in [*model.encoder, *model.decoder]:
        if isinstance(layer, (nn.Conv2d, nn.ConvTranspose2d, nn.Linear)):
            layer.register_forward_hook(lambda _m, _i, out: sizes.append(tuple(out.shape[1:])))
            if not isinstance(layer, nn.Linear):
                assert layer.kernel_size == (6, 6)
                assert layer.stride == (2, 2)
    with torch.inference_mode():
        feature = model.encode(torch.rand(2, 3, 112, 112))
        image = model.decode(feature)
    assert sizes == [
        (32, 55, 55),
        (64, 26, 26),
        (128, 12, 12),
        (1000,),
        (30,),
        (1000,),
        (18432,),
        (64, 26, 26),
        (32, 54, 54),
        (3, 112, 112),
    ]
    assert image.shape == (2, 3, 112, 112)
    assert feature.shape == (2, 30)
    assert feature.abs().max() <= 1.0


def test_relu_features_are_the_paper_s() -> None:
    model = ConvolutionalAutoencoder("relu")
    with torch.no_grad():
        feature = model.encode(torch.rand(4, 3, 112, 112))
    assert feature.min() == 0.0
    with pytest.raises(ValueError, match="gelu"):
        ConvolutionalAutoencoder("gelu")


def test_batch_norm_after_every_layer_but_the_picture() -> None:
    layers = [*ConvolutionalAutoencoder().encoder, *ConvolutionalAutoencoder().decoder]
    weighted = [i for i, m in enumerate(layers) if isinstance(m, (nn.Conv2d, nn.ConvTranspose2d, nn.Linear))]
    assert all(isinstance(layers[i + 1], (nn.BatchNorm1d, nn.BatchNorm2d)) for i in weighted[:-1])
    assert weighted[-1] == len(layers) - 1


def test_to_image_scales_and_turns_the_axes() -> None:
    rgb = torch.zeros(1, 112, 112, 3, dtype=torch.uint8)
    rgb[0, 5, 7, 2] = 255
    image = to_image(rgb)
    assert image.shape == (1, 3, 112, 112)
    assert image[0, 2, 5, 7] == 1.0
    assert image.sum() == 1.0
    assert image.is_contiguous(memory_format=torch.channels_last)
