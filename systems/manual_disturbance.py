"""A person's hand on the arm: holds it, or moves it away, as often and as long as a signal says."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive
from systems.disturbance import MOVE_TICKS

FREE, HOLD, MOVE = 0.0, 1.0, 2.0  # first component of the grip


class ManualDisturbance(LeafSystem):
    """Passes the command through, except while the grip says otherwise.

    .. pydrake_system::

        name: ManualDisturbance
        input_ports: [desired_posture, grip]
        output_ports: [disturbed_posture, active]

    Inputs:
        desired_posture: (M,) command of the controller, physical units.
        grip: (1 + J,) what the hand does, FREE, HOLD or MOVE, and the target of a MOVE, (J,), unit of the posture; read
            at the ticks only.
    Outputs:
        disturbed_posture: (M,) command for the arm, physical units. Direct feedthrough of `desired_posture` alone.
        active: (1,) 1 under HOLD and MOVE, else 0. No direct feedthrough.

    A grip begins at the tick at which it, or its target, differs from that of the tick before. The command that held
    until then is the command at its beginning. From that tick's update on, `disturbed_posture` is
        HOLD: the command at the beginning;
        MOVE: on a straight line in MOVE_TICKS equal steps from it to the target (the first step at once), then the
            target; components without a target keep the command at the beginning;
        FREE: the input.
    Grip, target, ticks since the beginning and the command at it are discrete state.
    """

    def __init__(self, *, posture_size: int, joints: int, period: float = 0.1):
        """
        Args:
            posture_size: M.
            joints: J; the first J components are moved.
            period: of the ticks, s.
        """
        super().__init__()
        self._size = require_count("posture_size", posture_size)
        self._joints = require_count("joints", joints, maximum=self._size)
        self._desired = self.DeclareVectorInputPort("desired_posture", self._size)
        self._grip = self.DeclareVectorInputPort("grip", 1 + self._joints)
        self._held = self.DeclareDiscreteState(1 + self._joints)  # the grip of this tick
        self._ticks = self.DeclareDiscreteState(1)  # since it began
        self._command = self.DeclareDiscreteState(self._size)  # at its beginning
        self.DeclareVectorOutputPort(
            "disturbed_posture", self._size, self._calc_posture, {self.xd_ticket(), self._desired.ticket()}
        )
        self.DeclareVectorOutputPort("active", 1, self._calc_active, {self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        grip, held = self._grip.Eval(context), context.get_discrete_state(self._held).value()
        if _kind(grip) == FREE:
            discrete_state.set_value(self._held, np.zeros(1 + self._joints))
        elif np.array_equal(grip, held):
            discrete_state.set_value(self._ticks, context.get_discrete_state(self._ticks).value() + 1.0)
        else:
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._command, self.GetOutputPort("disturbed_posture").Eval(context))
            discrete_state.set_value(self._held, grip)
            discrete_state.set_value(self._ticks, [0.0])

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        held = context.get_discrete_state(self._held).value()
        if (kind := _kind(held)) == FREE:
            output.SetFromVector(self._desired.Eval(context))
            return
        command = context.get_discrete_state(self._command).value().copy()
        if kind == MOVE:
            share = min((context.get_discrete_state(self._ticks)[0] + 1.0) / MOVE_TICKS, 1.0)
            joints = command[: self._joints]
            command[: self._joints] = (1.0 - share) * joints + share * held[1:]
        output.SetFromVector(command)

    def _calc_active(self, context: Context, output: BasicVector) -> None:
        output[0] = float(_kind(context.get_discrete_state(self._held).value()) != FREE)


def _kind(grip: np.ndarray) -> float:
    """FREE, HOLD or MOVE, whichever is nearest to the first component."""
    return float(np.clip(np.round(grip[0]), FREE, MOVE))
