"""The camera image as a few features: the encoder half of the autoencoder (Sec. III-A, Table I) as a system."""

import cv2
import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageRgba8U

from systems.arguments import require_count

ENCODED = 112  # width and height of the image that the encoder takes, pixels


class ImageEncoder(LeafSystem):
    """Encodes the image, f_k = encode(image).

    .. pydrake_system::

        name: ImageEncoder
        input_ports: [rgb_image]
        output_ports: [features]

    Inputs:
        rgb_image: ImageRgba8U of width x height pixels; its alpha channel is ignored.
    Outputs:
        features: (F,) image features, dimensionless, in [-1, 1]. Direct feedthrough; cached until the image changes.

    A larger image is first averaged down to 112 x 112 pixels.
    """

    def __init__(self, encoder, width: int = ENCODED, height: int = ENCODED):
        """
        Args:
            encoder: any object with `encode(rgb uint8 (112, 112, 3)) -> (F,)` and `feature_size` F.
            width, height: of the image at the port, pixels; equal, and at least 112.
        """
        super().__init__()
        self._width = require_count("width", width, ENCODED)
        self._height = require_count("height", height, ENCODED)
        if self._width != self._height:
            raise ValueError(
                f"The image is {width} x {height} pixels; the encoder was trained on square images, and another aspect "
                "would distort them: pass equal width and height."
            )
        self._encoder = encoder
        self._image = self.DeclareAbstractInputPort("rgb_image", AbstractValue.Make(ImageRgba8U(width, height)))
        self.DeclareVectorOutputPort(
            "features", require_count("feature_size", encoder.feature_size), self._calc_features, {self._image.ticket()}
        )

    def _calc_features(self, context: Context, output: BasicVector) -> None:
        image = self._image.Eval(context)
        if (image.width(), image.height()) != (self._width, self._height):
            raise ValueError(
                f"rgb_image is {image.width()} x {image.height()} pixels, the encoder was built for {self._width} x "
                f"{self._height}: pass the camera's size as width and height."
            )
        output.SetFromVector(self._encoder.encode(encoded_picture(image)))


def encoded_picture(image: ImageRgba8U) -> np.ndarray:
    """The picture (112, 112, 3) uint8 that the encoder takes of a square `image`, which is at least as large."""
    rgb = cv2.cvtColor(image.data, cv2.COLOR_RGBA2RGB)  # a tenth of the time of numpy's slice and copy
    if rgb.shape[:2] != (ENCODED, ENCODED):
        rgb = cv2.resize(rgb, (ENCODED, ENCODED), interpolation=cv2.INTER_AREA)
    return rgb
