"""The sensor of one joint sticks for a while."""

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from systems.faults.fault import Setting
from systems.faults.posture_fault import PostureFault


class JointStuck(PostureFault):
    """One joint's reading stays what it was at the onset; which one the seed says. The severity shortens how long.

    .. pydrake_system::

        name: JointStuck
        input_ports: [ticks_since_onset, posture]
        output_ports: [acting, faulty_posture]

    See PostureFault for the ports. The posture of the last tick before it acts is discrete state.
    """

    name = "joint_stuck"
    severity_1 = "one joint's reading stands still"
    lasts = False
    shortens = True

    def __init__(self, setting: Setting):
        super().__init__(setting)
        self._last = self.DeclareDiscreteState(setting.posture_size)
        self.DeclarePeriodicDiscreteUpdateEvent(setting.period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self._ticks(context) < 0:
            discrete_state.set_value(self._last, self._posture.Eval(context))

    def _altered(self, context: Context, posture: np.ndarray, severity: float) -> np.ndarray:
        joint = self._joint(context)
        posture[joint] = context.get_discrete_state(self._last)[joint]
        return posture
