"""What the recoveries share that do not lead home: they take so many ticks, and then the network goes on."""

from abc import abstractmethod

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive
from systems.detector import GUARD

TICKS = 20  # of a recovery: 2 s, the middle of the stops of disturbance B


class TimedRecovery(LeafSystem):
    """Takes the arm for TICKS ticks from the tick of an alarm on, then gives it back, wherever it is.

    After that the detector is not heard until the N + 2 postures that it may judge are all of the time since, and its
    alpha has been below 1/2 once: so a flag that stays up gives one recovery, not one after the other. Meanwhile, and
    during the recovery, the loop stays closed: the network is fed what is measured.

    Inputs (scaled, read at the ticks only):
        posture: (M,) m_k, as it is now.
        alarm: (1,) alpha_k of the detector.
    Outputs:
        acting: (1,) 1 in the ticks of a recovery, else 0: in the place of alpha_k. Direct feedthrough of `alarm`.
        recovery_step: (M,) scaled, in the place of dm^L_k; constant between ticks, 0 outside of a recovery and for the
            fingers.

    Discrete state: ticks since the recovery began (0: none did, or it is over and done with), the step.
    """

    def __init__(self, policy, joints: int, period: float):
        """`policy`: see `declare_detector_inputs`; joints: J; period: of the ticks, s."""
        super().__init__()
        self._size = require_count("policy.posture_size", policy.posture_size)
        self._joints = require_count("joints", joints, maximum=self._size)
        self._deaf = require_count("policy.horizon", policy.horizon) + 2
        self._posture = self.DeclareVectorInputPort("posture", self._size)
        self._alarm = self.DeclareVectorInputPort("alarm", 1)
        self._ticks = self.DeclareDiscreteState(1)
        self._step = self.DeclareDiscreteState(self._size)
        self._declare_more(policy)
        reads = {self._alarm.ticket(), self.discrete_state_ticket(self._ticks)}
        self.DeclareVectorOutputPort("acting", 1, self._calc_acting, reads)
        self.DeclareStateOutputPort("recovery_step", self._step)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _declare_more(self, policy) -> None:
        """Ports and state of a subclass."""

    @abstractmethod
    def _target(self, context: Context, discrete_state: DiscreteValues, posture: np.ndarray, first: bool) -> np.ndarray:
        """(M,) scaled: where the arm shall be in the next tick of a recovery, of which this is the first or not."""

    def _remember(self, context: Context, discrete_state: DiscreteValues, posture: np.ndarray) -> None:
        """Sees a tick outside of a recovery."""

    def acts(self, context: Context) -> bool:
        """Whether this tick, before its update, is one of a recovery."""
        ticks = context.get_discrete_state(self._ticks)[0]
        return bool(0 < ticks < TICKS or (ticks == 0 and self._alarm.Eval(context)[0] >= GUARD))

    def _calc_acting(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self.acts(context))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        ticks, posture = int(context.get_discrete_state(self._ticks)[0]), self._posture.Eval(context)
        step = np.zeros(self._size)
        if self.acts(context):
            target = self._target(context, discrete_state, posture, ticks == 0)
            step[: self._joints] = (target - posture)[: self._joints]
            ticks += 1
        else:
            self._remember(context, discrete_state, posture)
            if ticks:
                ticks = min(ticks + 1, TICKS + self._deaf)
                if ticks == TICKS + self._deaf and self._alarm.Eval(context)[0] < GUARD:
                    ticks = 0
        discrete_state.set_value(self._ticks, [ticks])
        discrete_state.set_value(self._step, step)
