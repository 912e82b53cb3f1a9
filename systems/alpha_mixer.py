"""The switch itself (Eq. 3): the RNN's step fades out as alpha rises, the LQR's is always there."""

import numpy as np
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_bounds, require_count, require_vector
from systems.elementwise import clamp, maximum


@TemplateSystem.define("AlphaMixer_")
def AlphaMixer_(T):
    class Impl(LeafSystem_[T]):
        """dm = (1 - alpha) dm^R + dm^L, Eq. 3, and the command m_k + dm within the limits of speed and position.

        alpha in Eq. 3 is the larger of alpha_k and alpha_{k-1} for the joints: a prediction made from what the network
        imagined (Eqs. 7, 8 with alpha_{k-1} > 0) is no command. For the fingers it is the largest of alpha_k, ...,
        alpha_{k-D}: for a few ticks more the network's state still turns from what it imagined to what it sees, and would
        open fingers that hold something because it imagined having put it down. It is a dwell time of the switch back;
        the switch away does not wait. The joints may not: the network sets out, and would not recall an arm that stands.

        .. pydrake_system::

            name: AlphaMixer
            input_ports:
            - posture
            - predicted_posture
            - regulator_step
            - alpha
            - last_alphas
            output_ports:
            - desired_posture
            - rnn_step
            - regulator_step
            - step

        Inputs (postures in the unit of the bounds, scaled or physical; steps in that unit per tick):
            posture: (M,) m_k as sampled at the tick, so that the command is constant between ticks.
            predicted_posture: (M,) m^R_{k+1}.
            regulator_step: (M,) dm^L_k; 0 in the fingers, which therefore keep their command under alpha = 1.
            alpha: (1,) alpha_k in [0, 1].
            last_alphas: (D,) alpha_{k-1}, ..., alpha_{k-D}; with the first the input of the prediction was closed.
        Outputs:
            desired_posture: (M,) m_k + dm, dm clamped to +-max_step, then the sum to [lower, upper].
            rnn_step: (M,) dm^R_k = m^R_{k+1} - m_k.
            regulator_step: (M,) dm^L_k.
            step: (M,) dm_k of Eq. 3, before clamping.
        Direct feedthrough; scalar-convertible.

        Constructor: keywords posture_size (M); lower, upper (M,), bounds of the command; max_step (M,) >= 0, largest
        step a tick; settling_ticks (D) >= 1; joints (J) <= M, the first J components are joints, the others fingers.
        """

        def _construct(
            self,
            *,
            posture_size: int,
            lower: np.ndarray,
            upper: np.ndarray,
            max_step: np.ndarray,
            settling_ticks: int = 1,
            joints: int = 0,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            size = require_count("posture_size", posture_size)
            self._joints = require_count("joints", joints, 0)
            if joints > size:
                raise ValueError(f"joints is {joints}, posture_size only {size}: pass a number up to that.")
            self._lower, self._upper = require_bounds("lower", lower, "upper", upper, size)
            self._max_step = require_vector("max_step", max_step, size, minimum=0.0)
            self._posture = self.DeclareVectorInputPort("posture", size)
            self._predicted = self.DeclareVectorInputPort("predicted_posture", size)
            self._regulator_step = self.DeclareVectorInputPort("regulator_step", size)
            self._alpha = self.DeclareVectorInputPort("alpha", 1)
            self._last_alphas = self.DeclareVectorInputPort(
                "last_alphas", require_count("settling_ticks", settling_ticks)
            )
            posture, predicted = self._posture.ticket(), self._predicted.ticket()
            alphas = {self._alpha.ticket(), self._last_alphas.ticket()}
            everything = {posture, predicted, self._regulator_step.ticket()} | alphas
            self.DeclareVectorOutputPort("desired_posture", size, self._calc_desired_posture, everything)
            self.DeclareVectorOutputPort("rnn_step", size, self._calc_rnn_step, {posture, predicted})
            self.DeclareVectorOutputPort(
                "regulator_step", size, self._calc_regulator_step, {self._regulator_step.ticket()}
            )
            self.DeclareVectorOutputPort("step", size, self._calc_step, everything)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self,
                posture_size=len(other._lower),
                lower=other._lower,
                upper=other._upper,
                max_step=other._max_step,
                settling_ticks=other._last_alphas.size(),
                joints=other._joints,
                converter=converter,
            )

        def _step(self, context):
            alphas = np.concatenate((self._alpha.Eval(context), self._last_alphas.Eval(context)))
            fingers = len(self._lower) - self._joints
            alpha = np.array([maximum(alphas[:2])] * self._joints + [maximum(alphas)] * fingers)
            rnn_step = self._predicted.Eval(context) - self._posture.Eval(context)
            return (1.0 - alpha) * rnn_step + self._regulator_step.Eval(context)

        def _calc_desired_posture(self, context, output):
            step = clamp(self._step(context), -self._max_step, self._max_step)
            output.SetFromVector(clamp(self._posture.Eval(context) + step, self._lower, self._upper))

        def _calc_rnn_step(self, context, output):
            output.SetFromVector(self._predicted.Eval(context) - self._posture.Eval(context))

        def _calc_regulator_step(self, context, output):
            output.SetFromVector(self._regulator_step.Eval(context))

        def _calc_step(self, context, output):
            output.SetFromVector(self._step(context))

    return Impl


AlphaMixer = AlphaMixer_[None]
