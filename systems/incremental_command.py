"""The way home in incremental form: a step is added to the last command, not to the measured posture."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.alpha_mixer import clamp
from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import GUARD


class IncrementalCommand(LeafSystem):
    """On the way home the command is c_k = c_{k-1} + dm_k instead of m_k + dm_k, from its second tick on.

    The posture regulator's step vanishes at home only. So where command and measured posture differ by a constant, an
    offset of the sensor or a servo that sags, m_k + dm_k rests where the step undoes that: ten times as far from home
    at K = 0.1. Added up, the steps go on until the *measured* posture is home (velocity form; Astrom and Hagglund,
    Advanced PID Control, 2006). While the arm goes where it is commanded to, both are the same. A servo that makes the
    share s of a step in a tick gives the loop z^2 - (2 - s - s K) z + 1 - s: stable for 0 < s <= 1, 0 < K < 1, with an
    overshoot of some percent where s is less than a third.

    Only a constant up to `largest_offset` is made up for, of sensor and servo together; of a larger one the rest
    remains. More would wind up where somebody holds the arm: let go, it would fling the can.

    .. pydrake_system::

        name: IncrementalCommand
        input_ports: [posture, desired_posture, alpha, sent_posture]
        output_ports: [incremental_posture]

    Inputs, as ClearanceFilter's:
        posture: (M,) m_k as sampled at the tick, joint angles in rad first.
        desired_posture: (M,) m_k + dm_k, same unit, dm_k the step of Eq. 3.
        alpha: (1,) alpha_k: below 1/2, on the learned motion, the command passes.
        sent_posture: (M,) c_k, what is made of the output further on; read by the update of the next tick alone.
    Output:
        incremental_posture: (M,) joints: m_k + dm_k + [c_{k-1} - m_k], [] clamped to +-largest_offset and 0 in the
            first tick of a way home; the command within +-max_step of m_k, and within [lower, upper]; the other
            components pass.

    Direct feedthrough of all but sent_posture. Discrete state: (1 + J,) whether the tick before was one of a way home,
    at first 0, and c_{k-1}, rad. No AutoDiff: it acts where the filter does, which has none.
    """

    def __init__(
        self,
        *,
        posture_size: int,
        joints: int,
        lower: np.ndarray,
        upper: np.ndarray,
        max_step: np.ndarray,
        largest_offset: float,
        period: float,
    ):
        """
        Args:
            posture_size: M.
            joints: J, the first J components are joint angles.
            lower, upper: (M,) limits of the command.
            max_step: (J,) largest difference of command and posture, rad.
            largest_offset: rad, above 0.
            period: of the ticks, s.
        """
        super().__init__()
        size = require_count("posture_size", posture_size)
        self._joints = require_count("joints", joints, 1, size)
        lower, upper = require_bounds("lower", lower, "upper", upper, size)
        self._lower, self._upper = lower[:joints], upper[:joints]
        self._max_step = require_vector("max_step", max_step, joints, minimum=0.0)
        self._largest_offset = np.full(joints, require_positive("largest_offset", largest_offset))
        self._posture = self.DeclareVectorInputPort("posture", size)
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._sent = self.DeclareVectorInputPort("sent_posture", size)
        self._last = self.DeclareDiscreteState(1 + joints)
        now = {port.ticket() for port in (self._posture, self._desired, self._alpha)}
        self.DeclareVectorOutputPort("incremental_posture", size, self._calc, {*now, self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _returning(self, context: Context) -> bool:
        return bool(self._alpha.Eval(context)[0] >= GUARD)

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        output.SetFromVector(desired)
        last = context.get_discrete_state(self._last).value()
        if not self._returning(context) or not last[0]:
            return
        posture = self._posture.Eval(context)[: self._joints]
        ahead = clamp(last[1:] - posture, -self._largest_offset, self._largest_offset)
        step = clamp(desired[: self._joints] - posture + ahead, -self._max_step, self._max_step)
        command = clamp(posture + step, self._lower, self._upper)
        output.SetFromVector(np.concatenate((command, desired[self._joints :])))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        sent = self._sent.Eval(context)[: self._joints]
        discrete_state.set_value(self._last, np.append(float(self._returning(context)), sent))
