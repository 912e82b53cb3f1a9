"""The computer is slow: the controller's step comes too late, and the arm goes on with the command that it has."""

from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from systems.faults.fault import Fault, Setting

LARGEST = 0.5  # share of the steps that is late at severity 1


class LateStep(Fault):
    """Half of the steps times s come late, s the severity: in such a tick the command of the tick before holds.

    .. pydrake_system::

        name: LateStep
        input_ports: [ticks_since_onset, desired_posture]
        output_ports: [acting, faulty_desired_posture]

    Inputs:
        desired_posture: (M,) command, constant between ticks, rad and m.
        share: (1,) in [0, 1], only with `told`: the share of the steps that is late, read at the ticks only.
    Outputs:
        faulty_desired_posture: (M,) the input; in a late tick what it was in the tick before. Direct feedthrough of
            `desired_posture` alone.

    Which steps are late is made of the seed and the tick: a larger share makes more of them late, beside those of a
    smaller one. The first that may be late is that after the onset. Whether this tick's step is late, and the command
    that it holds, are discrete state.
    """

    name = "late_step"
    severity_1 = "half of the controller's steps come late: the command of the tick before holds"
    acts_on = "command"

    def __init__(self, setting: Setting, told: bool = False):
        """`told`: a signal says tick by tick which share is late; onset and severity are not read."""
        super().__init__(setting)
        self._desired = self.DeclareVectorInputPort("desired_posture", setting.posture_size)
        self._share = self.DeclareVectorInputPort("share", 1) if told else None
        self._late = self.DeclareDiscreteState(1)
        self._held = self.DeclareDiscreteState(setting.posture_size)
        reads = {self.xd_ticket(), self._desired.ticket()}
        self.DeclareVectorOutputPort("faulty_desired_posture", setting.posture_size, self._calc_command, reads)
        self.DeclarePeriodicDiscreteUpdateEvent(setting.period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        share = LARGEST * self._strength(context) if self._share is None else self._share.Eval(context)[0]
        late = False
        if share > 0.0:
            late = self._chance(context, round(context.get_time() / self._setting.period)).random() < share
        if late:
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._held, self.GetOutputPort("faulty_desired_posture").Eval(context))
        discrete_state.set_value(self._late, [float(late)])

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        late = context.get_discrete_state(self._late)[0] > 0.5
        output.SetFromVector(context.get_discrete_state(self._held).value() if late else self._desired.Eval(context))
