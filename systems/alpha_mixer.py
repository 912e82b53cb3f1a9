"""The switch itself (Eq. 3): the RNN's step fades out as alpha rises, the LQR's is always there."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_bounds, require_count, require_vector
from systems.detector import GUARD


def clamp(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns `x` (n,) within the bounds (n,); float or AutoDiffXd. Twice as fast as np.clip on so few numbers."""
    return np.minimum(np.maximum(x, lower), upper)


@TemplateSystem.define("AlphaMixer_", T_list=[float, AutoDiffXd])
def AlphaMixer_(T):
    class Impl(LeafSystem_[T]):
        """dm = (1 - alpha_k) dm^R + dm^L, Eq. 3, with dm^R = m^R_{k+1} - m_k - dm^L; the command is m_k + dm.

        So the joints go to the network's posture at alpha = 0 and by the LQR's step at alpha = 1, within their limits
        of speed and position. The fingers take one of two values, open or closed, with hysteresis: open where the
        predicted opening is above the upper threshold, closed where it is below the lower one, else, and wherever
        alpha >= 1/2, their command stays what it is, m_k's.

        .. pydrake_system::

            name: AlphaMixer
            input_ports: [posture, predicted_posture, regulator_step, alpha]
            output_ports: [desired_posture, rnn_step]

        Inputs (postures in the unit of the bounds, scaled or physical; steps in that unit per tick):
            posture: (M,) m_k as sampled at the tick, so that the command is constant between ticks; fingers as
                commanded.
            predicted_posture: (M,) m^R_{k+1}.
            regulator_step: (M,) dm^L_k; not read for the fingers' command.
            alpha: (1,) alpha_k in [0, 1].
        Outputs:
            desired_posture: (M,) joints: m_k + dm, dm clamped to +-max_step, then the sum to [lower, upper]; fingers:
                open, closed, or m_k's.
            rnn_step: (M,) dm^R_k.
        Direct feedthrough; converts to AutoDiffXd.

        Constructor: keywords posture_size (M); joints (J) <= M, the first J components are joints, the others fingers;
        lower, upper (M,), bounds of the command; max_step (J,) >= 0, largest step a tick of the joints; where there are
        fingers, finger_openings (closed, open) and finger_thresholds (closed below, open above), a number or (M - J,)
        each, closed <= closed below < open above <= open, all within the bounds.
        """

        def _construct(
            self,
            *,
            posture_size,
            joints,
            lower,
            upper,
            max_step,
            finger_openings=((), ()),
            finger_thresholds=((), ()),
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            size = require_count("posture_size", posture_size)
            self._joints = require_count("joints", joints, 0, size)
            self._lower, self._upper = require_bounds("lower", lower, "upper", upper, size)
            self._max_step = require_vector("max_step", max_step, self._joints, minimum=0.0)
            fingers = size - self._joints
            self._closed, self._open = _pair("finger_openings", finger_openings, fingers)
            self._closed_below, self._open_above = _pair("finger_thresholds", finger_thresholds, fingers)
            low, high = self._lower[self._joints :], self._upper[self._joints :]
            rising = low, self._closed, self._closed_below, self._open_above, self._open, high
            if np.any(np.diff(rising, axis=0) < 0.0) or np.any(self._closed_below == self._open_above):
                raise ValueError(
                    f"finger_openings are {finger_openings} and finger_thresholds {finger_thresholds}, within the "
                    f"bounds {low} to {high}; needed is lower <= closed <= closed below < open above <= "
                    "open <= upper: pass such numbers."
                )
            self._arguments = dict(
                posture_size=size, joints=self._joints, lower=self._lower, upper=self._upper, max_step=self._max_step,
                finger_openings=(self._closed, self._open),
                finger_thresholds=(self._closed_below, self._open_above),
            )  # fmt: skip
            self._posture = self.DeclareVectorInputPort("posture", size)
            self._predicted = self.DeclareVectorInputPort("predicted_posture", size)
            self._regulator_step = self.DeclareVectorInputPort("regulator_step", size)
            self._alpha = self.DeclareVectorInputPort("alpha", 1)
            steps = {self._posture.ticket(), self._predicted.ticket(), self._regulator_step.ticket()}
            everything = {self.all_input_ports_ticket()}
            self.DeclareVectorOutputPort("desired_posture", size, self._calc_desired_posture, everything)
            self.DeclareVectorOutputPort("rnn_step", size, self._calc_rnn_step, steps)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, **other._arguments, converter=converter)

        def _rnn_step(self, context):
            step = self._predicted.Eval(context) - self._posture.Eval(context)
            return step - self._regulator_step.Eval(context)

        def _calc_rnn_step(self, context, output):
            output.SetFromVector(self._rnn_step(context))

        def _calc_desired_posture(self, context, output):
            posture, alpha, J = self._posture.Eval(context), self._alpha.Eval(context)[0], self._joints
            step = ((1.0 - alpha) * self._rnn_step(context) + self._regulator_step.Eval(context))[:J]
            joints = posture[:J] + clamp(step, -self._max_step, self._max_step)
            fingers = posture[J:]
            if alpha < GUARD:
                opening = self._predicted.Eval(context)[J:]
                fingers = np.where(opening > self._open_above, self._open, fingers)
                fingers = np.where(opening < self._closed_below, self._closed, fingers)
            output.SetFromVector(clamp(np.concatenate((joints, fingers)), self._lower, self._upper))

    return Impl


def _pair(name: str, values, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The two of `values`, (size,) each; a number stands for all components."""
    first, second = (np.full(size, value) if np.ndim(value) == 0 else value for value in values)
    return require_vector(name, first, size), require_vector(name, second, size)


AlphaMixer = AlphaMixer_[None]
