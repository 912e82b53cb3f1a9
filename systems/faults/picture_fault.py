"""What the faults of the camera share: a picture in, a picture out."""

from abc import abstractmethod

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageRgba8U

from systems.faults.fault import Fault, Setting


class PictureFault(Fault):
    """Input `rgb_image`, output `faulty_rgb_image`: ImageRgba8U of the setting's size. Direct feedthrough."""

    acts_on = "picture"

    def __init__(self, setting: Setting):
        super().__init__(setting)
        self._blank = AbstractValue.Make(ImageRgba8U(setting.width, setting.height))
        self._image = self.DeclareAbstractInputPort("rgb_image", self._blank)
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket(), self.all_state_ticket()}
        self.DeclareAbstractOutputPort("faulty_rgb_image", self._blank.Clone, self._calc_image, reads)

    @abstractmethod
    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        """What becomes of `rgb`, (height, width, 3) uint8: the same shape, any type; it is rounded to 0 .. 255."""

    def _calc_image(self, context: Context, output: AbstractValue) -> None:
        picture = output.get_mutable_value().mutable_data
        picture[:] = self._image.Eval(context).data
        if severity := self._strength(context):
            rgb = picture[:, :, :3]
            rgb[:] = np.clip(np.rint(self._altered(context, np.ascontiguousarray(rgb), severity)), 0, 255)
