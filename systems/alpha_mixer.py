"""The switch itself (Eq. 3): the RNN's step fades out as alpha rises, the LQR's is always there."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_bounds, require_count, require_vector


def clamp(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns `x` (n,) within the bounds (n,); float or AutoDiffXd. Twice as fast as np.clip on so few numbers."""
    return np.minimum(np.maximum(x, lower), upper)


@TemplateSystem.define("AlphaMixer_", T_list=[float, AutoDiffXd])
def AlphaMixer_(T):
    class Impl(LeafSystem_[T]):
        """dm = (1 - alpha) dm^R + dm^L, Eq. 3, and the command m_k + dm within the limits of speed and position.

        alpha in Eq. 3 is the larger of alpha_k and alpha_{k-1} for the joints: a prediction made from what the network
        imagined (Eqs. 7, 8 with alpha_{k-1} > 0) is no command. For the fingers it is the largest of alpha_k, ...,
        alpha_{k-D}: for a few ticks more the network's state still turns from what it imagined to what it sees, and
        would open fingers that hold something because it imagined having put it down. It is a dwell time of the switch
        back; the switch away does not wait. The joints may not wait either: the network sets out, and would not recall
        an arm that stands.

        .. pydrake_system::

            name: AlphaMixer
            input_ports: [posture, predicted_posture, regulator_step, alpha, last_alphas]
            output_ports: [desired_posture, rnn_step]

        Inputs (postures in the unit of the bounds, scaled or physical; steps in that unit per tick):
            posture: (M,) m_k as sampled at the tick, so that the command is constant between ticks.
            predicted_posture: (M,) m^R_{k+1}.
            regulator_step: (M,) dm^L_k; 0 in the fingers, which therefore keep their command under alpha = 1.
            alpha: (1,) alpha_k in [0, 1].
            last_alphas: (D,) alpha_{k-1}, ..., alpha_{k-D}; with the first the input of the prediction was closed.
        Outputs:
            desired_posture: (M,) m_k + dm, dm clamped to +-max_step, then the sum to [lower, upper].
            rnn_step: (M,) dm^R_k = m^R_{k+1} - m_k.
        Direct feedthrough; converts to AutoDiffXd.

        Constructor: keywords posture_size (M); joints (J) <= M, the first J components are joints, the others fingers;
        lower, upper (M,), bounds of the command; max_step (M,) >= 0, largest step a tick; settling_ticks (D) >= 1.
        """

        def _construct(self, *, posture_size, joints, lower, upper, max_step, settling_ticks=1, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            size = require_count("posture_size", posture_size)
            self._is_joint = np.arange(size) < require_count("joints", joints, 0, size)
            self._lower, self._upper = require_bounds("lower", lower, "upper", upper, size)
            self._max_step = require_vector("max_step", max_step, size, minimum=0.0)
            ticks = require_count("settling_ticks", settling_ticks)
            limits = dict(lower=self._lower, upper=self._upper, max_step=self._max_step)
            self._arguments = dict(posture_size=size, joints=joints, settling_ticks=ticks, **limits)
            self._posture = self.DeclareVectorInputPort("posture", size)
            self._predicted = self.DeclareVectorInputPort("predicted_posture", size)
            self._regulator_step = self.DeclareVectorInputPort("regulator_step", size)
            self._alpha = self.DeclareVectorInputPort("alpha", 1)
            self._last_alphas = self.DeclareVectorInputPort("last_alphas", ticks)
            prediction = {self._posture.ticket(), self._predicted.ticket()}
            everything = {self.all_input_ports_ticket()}
            self.DeclareVectorOutputPort("desired_posture", size, self._calc_desired_posture, everything)
            self.DeclareVectorOutputPort("rnn_step", size, self._calc_rnn_step, prediction)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, **other._arguments, converter=converter)

        def _rnn_step(self, context):
            return self._predicted.Eval(context) - self._posture.Eval(context)

        def _calc_rnn_step(self, context, output):
            output.SetFromVector(self._rnn_step(context))

        def _calc_desired_posture(self, context, output):
            alpha, last = self._alpha.Eval(context)[0], self._last_alphas.Eval(context)
            alpha = np.where(self._is_joint, max(alpha, last[0]), max(alpha, last.max()))
            step = (1.0 - alpha) * self._rnn_step(context) + self._regulator_step.Eval(context)
            step = clamp(step, -self._max_step, self._max_step)
            output.SetFromVector(clamp(self._posture.Eval(context) + step, self._lower, self._upper))

    return Impl


AlphaMixer = AlphaMixer_[None]
