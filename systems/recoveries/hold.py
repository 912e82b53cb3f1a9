"""Hold, and go on."""

from systems.recoveries.timed_recovery import TimedRecovery


class HoldRecovery(TimedRecovery):
    """The arm stands still where the alarm found it; then the network, which looked on meanwhile, goes on.

    .. pydrake_system::

        name: HoldRecovery
        input_ports: [posture, alarm]
        output_ports: [acting, recovery_step]

    Ports, and what ends it: see TimedRecovery. Discrete state: the posture too.
    """

    name = "hold"
    looks = False

    @staticmethod
    def build(policy, joints, period):
        """Returns the system; see TimedRecovery."""
        return HoldRecovery(policy, joints, period)

    def _declare_more(self, policy):
        self._held = self.DeclareDiscreteState(self._size)

    def _target(self, context, discrete_state, posture, first):
        held = posture if first else context.get_discrete_state(self._held).value()
        discrete_state.set_value(self._held, held)
        return held
