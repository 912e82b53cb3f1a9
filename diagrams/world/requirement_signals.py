"""RequirementSignals: what the requirements of requirements.stl look at, a number a tick each."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.requirements import SIGNALS
from diagrams.world.task import at_home
from systems.detector import GUARD


class RequirementSignals(LeafSystem):
    """The signals, by the names of SIGNALS.

    .. pydrake_system::

        name: RequirementSignals
        input_ports:
        - alpha
        - active
        - clearance
        - posture
        - desired_posture
        output_ports:
        - signals

    All inputs are constant between two ticks, and so are the signals; to be read there.

    - `alpha` (1): alpha_k, held.
    - `active` (1): above 1/2 while the arm is disturbed.
    - `clearance` (1), m: see ClearanceMeter.
    - `posture` (8), `desired_posture` (8): m_k and the controller's command, joints, rad, and the fingers' gap, m.
    - `signals` (7): alpha; active, 1 or 0; home, 1 where the arm is at its initial posture (see task.py), else 0;
      crossings of alpha through 1/2 in the last second; clearance, m; position_margin, how far the joints' command is
      within the limits, where that is least, rad, negative beyond; speed_margin, the same of the joints' speed from m_k
      to the command within a tick, rad/s.

    Whether alpha was 1/2 or more in the ticks of the last second is discrete state.
    """

    def __init__(self, world: World, lower: np.ndarray, upper: np.ndarray, speed: np.ndarray):
        """`lower`, `upper`, `speed`: (8,) limits of the command, see `controller_limits`."""
        super().__init__()
        self._lower, self._upper, self._speed = (limit[:ARM_JOINTS] for limit in (lower, upper, speed))
        self._initial, self._period = world.initial_posture[:ARM_JOINTS], world.timing.period
        sizes = {"alpha": 1, "active": 1, "clearance": 1, "posture": ARM_JOINTS + 1, "desired_posture": ARM_JOINTS + 1}
        self._inputs = {name: self.DeclareVectorInputPort(name, size) for name, size in sizes.items()}
        self._high = self.DeclareDiscreteState(max(1, round(1.0 / self._period)))  # the newest last
        self.DeclareVectorOutputPort("signals", len(SIGNALS), self._calc_signals)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _highs(self, context: Context) -> np.ndarray:
        """Of the ticks of a second ago up to this one."""
        now = float(self._inputs["alpha"].Eval(context)[0] >= GUARD)
        return np.append(context.get_discrete_state(self._high).value(), now)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        # The update sees the alpha of the tick before; before the first one that is 0.
        discrete_state.set_value(self._high, self._highs(context)[1:])

    def _calc_signals(self, context: Context, output: BasicVector) -> None:
        alpha, active, clearance, posture, command = (port.Eval(context) for port in self._inputs.values())
        joints, command = posture[:ARM_JOINTS], command[:ARM_JOINTS]
        output.SetFromVector(
            [
                alpha[0],
                float(active[0] > 0.5),
                float(at_home(joints, self._initial)),
                np.abs(np.diff(self._highs(context))).sum(),
                clearance[0],
                np.minimum(command - self._lower, self._upper - command).min(),
                (self._speed - np.abs(command - joints) / self._period).min(),
            ]
        )
