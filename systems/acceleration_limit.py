"""The way home speeds up evenly: a step is not much longer than what the joint moved in the tick before."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.alpha_mixer import clamp
from systems.arguments import require_count, require_positive, require_vector
from systems.detector import GUARD


class AccelerationLimit(LeafSystem):
    """On the way home a step is at most what the joint moved in the tick before, and acceleration * period^2 more.

    The posture regulator asks for its largest step at once. From rest, from far, the servo cannot follow that: light
    joints start at once and heavy ones late, and the torques of the heavy ones throw others back. So no joint is told
    to start faster than the servo follows. What stands behind may ask for more: the clearance filter, to get away.

    The bound is on the step from where the arm is measured. So a servo that sags by acceleration * period^2 or more a
    tick does not hold the arm, which drifts; without the limit it would rest ten times as far from home as it sags.

    .. pydrake_system::

        name: AccelerationLimit
        input_ports: [posture, desired_posture, alpha]
        output_ports: [limited_posture]

    Inputs, as ClearanceFilter's:
        posture: (M,) m_k as sampled at the tick, joint angles in rad first.
        desired_posture: (M,) m_k + dm_k, same unit.
        alpha: (1,) alpha_k: below 1/2, on the learned motion, the command passes.
    Output:
        limited_posture: (M,) joints: m_k + dm', dm' = dm_k clamped to +-(|m_k - m_{k-1}| + acceleration * period^2),
            whatever moved the joint; the other components pass.

    Direct feedthrough. Discrete state: (J,) m_{k-1}, rad. No AutoDiff: it acts where the clearance filter does, which
    has none.
    """

    def __init__(self, *, joints: int, initial_posture: np.ndarray, acceleration: float, period: float):
        """
        Args:
            joints: J, the first J components are joint angles.
            initial_posture: (M,) stands for every posture before the first tick.
            acceleration: rad/s^2, above 0.
            period: of the ticks, s.
        """
        super().__init__()
        size = len(initial_posture)
        self._joints = require_count("joints", joints, 1, size)
        initial = require_vector("initial_posture", initial_posture, size)
        period = require_positive("period", period)
        self._growth = require_positive("acceleration", acceleration) * period**2
        self._posture = self.DeclareVectorInputPort("posture", size)
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._last = self.DeclareDiscreteState(initial[: self._joints])
        self.DeclareVectorOutputPort(
            "limited_posture", size, self._calc, {self.all_input_ports_ticket(), self.xd_ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _calc(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        output.SetFromVector(desired)
        if self._alpha.Eval(context)[0] < GUARD:
            return
        joints = self._posture.Eval(context)[: self._joints]
        largest = np.abs(joints - context.get_discrete_state(self._last).value()) + self._growth
        step = desired[: self._joints] - joints
        limited = clamp(step, -largest, largest)
        if not np.array_equal(limited, step):
            output.SetFromVector(np.concatenate((joints + limited, desired[self._joints :])))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(self._last, self._posture.Eval(context)[: self._joints])
