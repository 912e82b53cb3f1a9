"""The picture stands still for a while."""

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from systems.faults.fault import Setting
from systems.faults.picture_fault import PictureFault


class CameraFrozen(PictureFault):
    """Every picture while it acts is that of the tick of the onset; the severity shortens how long.

    .. pydrake_system::

        name: CameraFrozen
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports. The picture of the last tick before it acts is abstract state.
    """

    name = "camera_frozen"
    severity_1 = "every frame is that of the onset"
    lasts = False
    shortens = True

    def __init__(self, setting: Setting):
        super().__init__(setting)
        self._last = self.DeclareAbstractState(self._blank)
        self.DeclarePeriodicUnrestrictedUpdateEvent(setting.period, 0.0, self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        if self._ticks(context) >= 0:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state().get_mutable_value(int(self._last)).set_value(self._image.Eval(context))
        return EventStatus.Succeeded()

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        return context.get_abstract_state(int(self._last)).get_value().data[:, :, :3]
