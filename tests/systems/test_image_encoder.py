"""ImageEncoder: what of the image is encoded, and when."""

import pytest
from pydrake.systems.sensors import ImageRgba8U

from systems.image_encoder import ImageEncoder
from tests.systems.controller_fakes import FakeEncoder, image
from tests.systems.system_checks import evaluate


class RecordingEncoder(FakeEncoder):
    """Keeps the last image."""

    def encode(self, rgb):
        self.image = rgb.copy()
        return super().encode(rgb)


def test_image_encoder_drops_the_alpha_channel():
    picture = image(0)
    picture.mutable_data[3, 7] = [10, 20, 30, 255]
    encoder = RecordingEncoder(feature_size=2)
    features = evaluate(ImageEncoder(encoder), "features", dict(rgb_image=picture))
    assert encoder.image.shape == (112, 112, 3)
    assert encoder.image[3, 7].tolist() == [10, 20, 30]  # row 3, column 7
    mean = 60.0 / (112 * 112 * 3) / 255.0
    assert features == pytest.approx([mean / 2.0, mean])


def test_image_encoder_averages_a_larger_image_down():
    picture = image(0, 224)
    picture.mutable_data[6:8, 14:16] = [[[0] * 4, [40] * 4], [[80] * 4, [120] * 4]]
    encoder = RecordingEncoder()
    evaluate(ImageEncoder(encoder, 224, 224), "features", dict(rgb_image=picture))
    assert encoder.image.shape == (112, 112, 3)
    assert encoder.image[3, 7].tolist() == [60, 60, 60]
    assert encoder.image.sum() == 180


def test_image_encoder_refuses_another_size_and_encodes_once():
    encoder = FakeEncoder()
    system = ImageEncoder(encoder)
    context = system.CreateDefaultContext()
    port = system.GetOutputPort("features")
    system.GetInputPort("rgb_image").FixValue(context, image())
    port.Eval(context)
    context.SetTime(1.0)
    port.Eval(context)
    assert encoder.calls == 1
    system.GetInputPort("rgb_image").FixValue(context, ImageRgba8U(64, 112))
    with pytest.raises(ValueError, match="64 x 112 pixels, the encoder was built for 112 x 112"):
        port.Eval(context)
