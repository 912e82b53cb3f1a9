"""Back along the own last ticks, and on again from there."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from systems.recoveries.timed_recovery import TICKS, TimedRecovery


class RetraceRecovery(TimedRecovery):
    """In its i-th tick the arm is led to where it was i ticks before the alarm, and the network remembers what it did
    then: its hidden state, its prediction and its recall of that tick.

    As who rewinds to a checkpoint, 2 s back. Before the first tick the arm rested, and so did the network. What a
    detector itself remembers (`innovation_cusum`, `ensemble`) is not led back.

    .. pydrake_system::

        name: RetraceRecovery
        input_ports: [posture, alarm, hidden_state, recalled_postures, predicted_features]
        output_ports: [memory, acting, recovery_step]

    Further ports, see TimedRecovery for the others and for what ends it:
        hidden_state, recalled_postures, predicted_features: of RecurrentPolicy, as they are before the tick's update.
        memory: (1 + S + (N + 1) M + F,) 1 in a tick of the recovery and what the network shall remember after it; else
            0 and what it did. Direct feedthrough of `alarm`.

    Discrete state: postures and memories of the last TICKS ticks, the newest first.
    """

    name = "retrace"
    looks = False

    @staticmethod
    def build(policy, joints, period):
        """Returns the system; see TimedRecovery."""
        return RetraceRecovery(policy, joints, period)

    def _declare_more(self, policy):
        home = policy.scaling.scale(np.asarray(policy.initial_posture, float))
        recalled = np.tile(np.clip(home, -1.0, 1.0), policy.horizon + 1)
        parts = np.asarray(policy.initial_state, float), recalled, np.zeros(policy.feature_size)
        rest = np.concatenate((home, *parts))
        self._width = len(rest)
        names = ("hidden_state", "recalled_postures", "predicted_features")
        self._parts = [self.DeclareVectorInputPort(name, len(part)) for name, part in zip(names, parts, strict=True)]
        self._kept = self.DeclareDiscreteState(np.tile(rest, TICKS))
        reads = {self._alarm.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort("memory", 1 + self._width - self._size, self._calc_memory, reads)

    def _calc_memory(self, context: Context, output: BasicVector) -> None:
        newest = context.get_discrete_state(self._kept).value()[self._size : self._width]
        output.SetFromVector(np.append(float(self.acts(context)), newest))

    def _remember(self, context, discrete_state, posture):
        kept = context.get_discrete_state(self._kept).value()
        now = [posture, *(port.Eval(context) for port in self._parts)]
        discrete_state.set_value(self._kept, np.concatenate((*now, kept[: -self._width])))

    def _target(self, context, discrete_state, posture, first):
        kept = context.get_discrete_state(self._kept).value()
        # Once all of it is gone back along, the arm waits at its oldest tick.
        discrete_state.set_value(self._kept, np.concatenate((kept[self._width :], kept[-self._width :])))
        return kept[: self._size].copy()
