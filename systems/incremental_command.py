"""The way home in incremental form: a step is added to the last command, not to the measured posture."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.alpha_mixer import clamp
from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import GUARD


class IncrementalCommand(LeafSystem):
    """On the way home the command is c_k = c_{k-1} + dm_k instead of m_k + dm_k.

    The posture regulator's step vanishes at home only. So where command and measured posture differ by a constant, an
    offset of the sensor or a servo that sags, m_k + dm_k rests where the step undoes that: ten times as far from home
    at K = 0.1. Added up, the steps go on until the *measured* posture is home (velocity form; Astrom and Hagglund,
    Advanced PID Control, 2006). While the arm goes where it is commanded to, both are the same. A servo that makes the
    share s of a step in a tick gives the loop z^2 - (2 - s) z + 1 - s + s K: stable for 0 < s <= 1, 0 < K < 1.

    So only a constant up to `largest_offset` is made up for. More would wind up where somebody holds the arm: it would
    spring off when it is let go, and fling the can.

    .. pydrake_system::

        name: IncrementalCommand
        input_ports: [posture, desired_posture, alpha, sent_posture]
        output_ports: [incremental_posture]

    Inputs, as ClearanceFilter's:
        posture: (M,) m_k as sampled at the tick, joint angles in rad first.
        desired_posture: (M,) m_k + dm_k, same unit.
        alpha: (1,) alpha_k: below 1/2, on the learned motion, the command passes.
        sent_posture: (M,) c_k, what is made of the output further on; read by the update of the next tick alone.
    Output:
        incremental_posture: (M,) joints: m_k + dm_k + [c_{k-1} - m_k], [] clamped to +-largest_offset; the command
            within +-max_step of m_k, and within [lower, upper]; the other components pass.

    Direct feedthrough of all but sent_posture. Discrete state: (J,) c_{k-1}, rad, on the learned motion too; at first
    the initial posture. No AutoDiff: it acts where the filter does, which has none.
    """

    def __init__(
        self,
        *,
        initial_posture: np.ndarray,
        joints: int,
        lower: np.ndarray,
        upper: np.ndarray,
        max_step: np.ndarray,
        largest_offset: float,
        period: float,
    ):
        """
        Args:
            initial_posture: (M,), rad first.
            joints: J, the first J components are joint angles.
            lower, upper: (M,) limits of the command.
            max_step: (J,) largest difference of command and posture, rad.
            largest_offset: rad, above 0.
            period: of the ticks, s.
        """
        super().__init__()
        size = len(initial_posture)
        self._joints = require_count("joints", joints, 1, size)
        initial = require_vector("initial_posture", initial_posture, size)
        lower, upper = require_bounds("lower", lower, "upper", upper, size)
        self._lower, self._upper = lower[:joints], upper[:joints]
        self._max_step = require_vector("max_step", max_step, joints, minimum=0.0)
        self._largest_offset = np.full(joints, require_positive("largest_offset", largest_offset))
        self._posture = self.DeclareVectorInputPort("posture", size)
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._last = self.DeclareDiscreteState(initial[:joints])
        self._sent = self.DeclareVectorInputPort("sent_posture", size)
        now = {port.ticket() for port in (self._posture, self._desired, self._alpha)}
        self.DeclareVectorOutputPort("incremental_posture", size, self._calc, {*now, self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _command(self, context: Context) -> np.ndarray:
        """(J,) c_k."""
        desired = self._desired.Eval(context)[: self._joints]
        if self._alpha.Eval(context)[0] < GUARD:
            return desired
        posture = self._posture.Eval(context)[: self._joints]
        ahead = context.get_discrete_state(self._last).value() - posture
        step = desired - posture + clamp(ahead, -self._largest_offset, self._largest_offset)
        return clamp(posture + clamp(step, -self._max_step, self._max_step), self._lower, self._upper)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate((self._command(context), self._desired.Eval(context)[self._joints :])))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(self._last, self._sent.Eval(context)[: self._joints])
