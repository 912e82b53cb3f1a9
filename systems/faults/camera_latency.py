"""The picture comes late."""

import math

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from systems.faults.fault import Setting
from systems.faults.picture_fault import PictureFault

LARGEST = 3  # ticks, at severity 1


class CameraLatency(PictureFault):
    """The picture of a tick is that of 3 s ticks before, rounded up, s the severity.

    .. pydrake_system::

        name: CameraLatency
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports. The pictures of the last three ticks are abstract state; before the first tick
    there was none, and the present one is given.
    """

    name = "camera_latency"
    severity_1 = "3 ticks late (0.3 s)"

    def __init__(self, setting: Setting):
        super().__init__(setting)
        # A ring: the picture of tick k is in place k % 3. And how many ticks were seen.
        self._ring = [self.DeclareAbstractState(self._blank) for _ in range(LARGEST)]
        self._seen = self.DeclareDiscreteState([0.0])
        self.DeclarePeriodicUnrestrictedUpdateEvent(setting.period, 0.0, self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        seen = int(context.get_discrete_state(self._seen)[0])
        place = int(self._ring[seen % LARGEST])
        state.get_mutable_abstract_state().get_mutable_value(place).set_value(self._image.Eval(context))
        state.get_mutable_discrete_state().get_mutable_vector(int(self._seen)).SetAtIndex(0, seen + 1.0)
        return EventStatus.Succeeded()

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        seen = int(context.get_discrete_state(self._seen)[0])
        # At a tick, before its update, the last one kept is that of the tick before.
        late = min(math.ceil(LARGEST * severity - 1e-9), seen)
        if not late:
            return rgb
        return context.get_abstract_state(int(self._ring[(seen - late) % LARGEST])).get_value().data[:, :, :3]
