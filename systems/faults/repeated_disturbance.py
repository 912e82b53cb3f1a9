"""What the disturbances that come more than once share: the arm is moved away, and again."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from systems.disturbance import MOVE_TICKS, DisturbanceParameters
from systems.faults.fault import Fault, Setting

HIGH, LOW = 0.5, 0.1  # alpha from which on the arm is led home, and down to which the network has it again


class RepeatedDisturbance(Fault):
    """Moves the arm to one target after the other, as Disturbance does under A, and holds it there.

    Of the way to a target it goes the share s, the severity. The first begins with the tick after the onset, the others
    when the class says.

    Inputs:
        desired_posture: (M,) command, rad and m.
        alpha: (1,) of the controller; read at the ticks only.
    Outputs:
        faulty_desired_posture: (M,) command for the arm. Direct feedthrough of `desired_posture` alone.

    Discrete state: how many have begun, ticks of the one under way (-1: none is), ticks since the last one's end,
    whether alpha has risen since then; and the command at the beginning.
    """

    acts_on = "command"
    lasts = False
    takes_arm = True
    targets = 2
    home_share: ClassVar[float] = 1.0  # of the way home that the arm has gone where it is moved again

    def __init__(self, setting: Setting):
        super().__init__(setting)
        size = setting.posture_size
        self._places = self.DeclareNumericParameter(BasicVector(np.zeros(self.targets * setting.joints)))
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._command = self.DeclareDiscreteState(size)
        reads = {self.xd_ticket(), self.pn_ticket(), self._desired.ticket()}
        self.DeclareVectorOutputPort("faulty_desired_posture", size, self._calc_command, reads)
        self.DeclarePeriodicDiscreteUpdateEvent(setting.period, 0.0, self._update)

    def _declare_acting(self) -> None:
        self._phase = self.DeclareDiscreteState([0.0, -1.0, 0.0, 0.0])
        self.DeclareVectorOutputPort("acting", 1, self._calc_acting, {self.xd_ticket()})

    def set_parameters(self, context: Context, given: DisturbanceParameters, seed: int) -> None:
        """See Fault; `given.target`: the targets (J,), rad, one after the other."""
        super().set_parameters(context, given, seed)
        if given.target is not None:
            context.get_mutable_numeric_parameter(self._places).SetFromVector(np.array(given.target))

    @abstractmethod
    def _due(self, rest: int, alpha: float, risen: bool) -> bool:
        """Whether the next one begins: `rest` ticks after the last one's end, `risen`: alpha was high since then."""

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        begun, ticks, rest, risen = context.get_discrete_state(self._phase).value()
        severity, hold, _ = context.get_numeric_parameter(self._given).value()
        if ticks >= 0.0:
            over = ticks + 1.0 >= MOVE_TICKS + hold
            phase = [begun, -1.0, 0.0, 0.0] if over else [begun, ticks + 1.0, 0.0, 0.0]
        else:
            alpha = float(self._alpha.Eval(context)[0])
            rest, risen = rest + 1.0, float(risen or alpha >= HIGH)
            due = self._due(int(rest), alpha, bool(risen)) if begun else self._ticks(context) >= 0
            begins = due and severity > 0.0 and begun < self.targets
            phase = [begun + 1.0, 0.0, 0.0, 0.0] if begins else [begun, -1.0, rest, risen]
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._command, self._desired.Eval(context))
        discrete_state.set_value(self._phase, phase)

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        begun, ticks, _, _ = context.get_discrete_state(self._phase).value()
        if ticks < 0.0:
            output.SetFromVector(self._desired.Eval(context))
            return
        command, joints = context.get_discrete_state(self._command).value().copy(), self._setting.joints
        first = (int(begun) - 1) * joints
        target = context.get_numeric_parameter(self._places).value()[first : first + joints]
        share = self.severity(context) * min((ticks + 1.0) / MOVE_TICKS, 1.0)
        command[:joints] = (1.0 - share) * command[:joints] + share * target
        output.SetFromVector(command)

    def _calc_acting(self, context: Context, output: BasicVector) -> None:
        output[0] = float(context.get_discrete_state(self._phase)[1] >= 0.0)
