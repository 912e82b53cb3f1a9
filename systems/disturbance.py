"""The experimenter's hand: moves the arm away, or stops it, once in an episode (Sec. IV)."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive, require_vector

KINDS = ("none", "A", "B")


class Disturbance(LeafSystem):
    """Passes the command through, except during one disturbance.

    .. pydrake_system::

        name: Disturbance
        input_ports:
        - desired_posture
        - trigger
        output_ports:
        - disturbed_posture
        - active

    Inputs:
        desired_posture: (M,) command of the controller, physical units.
        trigger: (1,) what the onset is measured in, such as a distance in m; read at the ticks only.
    Outputs:
        disturbed_posture: (M,) command for the arm, physical units. Direct feedthrough of `desired_posture` alone.
        active: (1,) 1 during the disturbance, else 0. No direct feedthrough.

    The onset is the first tick at which trigger < trigger_level. The command that held until then is the command at
    the onset. From that tick's update on, `disturbed_posture` is
        kind "A": on a straight line in `move_ticks` equal steps from the command at the onset to the target (the first
            step at once), then the target for `hold_ticks`; where the target is NaN, the command at the onset;
        kind "B": the command at the onset for `hold_ticks`;
        kind "none": the input, always.
    Afterwards it's transparent again, and stays so. Ticks since the onset and the command at the onset are discrete
    state; kind, target, level and hold are Context parameters, so one diagram serves all episodes.
    """

    def __init__(
        self,
        *,
        posture_size: int,
        kind: str = "none",
        target_posture: np.ndarray | None = None,
        trigger_level: float = 0.0,
        move_ticks: int = 8,
        hold_ticks: int = 10,
        period: float = 0.1,
    ):
        """
        Args:
            posture_size: M.
            kind, target_posture, trigger_level, hold_ticks: defaults of the parameters, see `set_disturbance`.
            move_ticks: duration of the move of kind "A", ticks.
            period: of the ticks, s.
        """
        super().__init__()
        self._size = require_count("posture_size", posture_size)
        self._move_ticks = require_count("move_ticks", move_ticks)
        schedule, target = self._check(kind, target_posture, trigger_level, hold_ticks)
        self._schedule = self.DeclareNumericParameter(BasicVector(schedule))
        self._target = self.DeclareNumericParameter(BasicVector(target))
        self._ticks = self.DeclareDiscreteState([-1.0])  # since the onset; -1 before it
        self._onset_command = self.DeclareDiscreteState(self._size)
        self._desired = self.DeclareVectorInputPort("desired_posture", self._size)
        self._trigger = self.DeclareVectorInputPort("trigger", 1)
        state = {self.xd_ticket(), self.pn_ticket()}
        self.DeclareVectorOutputPort(
            "disturbed_posture", self._size, self._calc_posture, state | {self._desired.ticket()}
        )
        self.DeclareVectorOutputPort("active", 1, self._calc_active, state)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def set_disturbance(
        self,
        context: Context,
        kind: str,
        target_posture: np.ndarray | None = None,
        trigger_level: float = 0.0,
        hold_ticks: int = 0,
    ) -> None:
        """Sets the parameters of an episode in this system's Context (not the root's); leaves its state alone.

        Args:
            kind: "none", "A" or "B".
            target_posture: (M,) of kind "A", physical units; NaN in the components that keep their command.
            trigger_level: the onset is the first tick with trigger < trigger_level; unit of the trigger.
            hold_ticks: duration of the hold, ticks; at least 1 for kind "B".
        """
        schedule, target = self._check(kind, target_posture, trigger_level, hold_ticks)
        context.get_mutable_numeric_parameter(self._schedule).SetFromVector(schedule)
        context.get_mutable_numeric_parameter(self._target).SetFromVector(target)

    def _check(self, kind, target_posture, trigger_level, hold_ticks) -> tuple[list[float], np.ndarray]:
        """Returns the parameter vectors [number of the kind, trigger level, hold ticks] and the target (M,)."""
        if kind not in KINDS:
            raise ValueError(f"kind is {kind!r}; it must be one of {', '.join(KINDS)}: pass one of them.")
        if math.isnan(trigger_level):
            raise ValueError("trigger_level is nan; it must be a number: pass the level that starts the disturbance.")
        if target_posture is None:
            if kind == "A":
                raise ValueError('target_posture is None; kind "A" moves the arm to it: pass a posture.')
            target_posture = np.full(self._size, np.nan)
        target = require_vector("target_posture", target_posture, self._size, allow_nan=True)
        hold_ticks = require_count("hold_ticks", hold_ticks, 1 if kind == "B" else 0)
        return [float(KINDS.index(kind)), float(trigger_level), float(hold_ticks)], target

    def _parameters(self, context: Context) -> tuple[str, float, float]:
        number, level, hold_ticks = context.get_numeric_parameter(self._schedule).value()
        return KINDS[int(number)], level, hold_ticks

    def _is_active(self, context: Context) -> bool:
        kind, _, hold_ticks = self._parameters(context)
        ticks = context.get_discrete_state(self._ticks).value()[0]
        return kind != "none" and 0 <= ticks < hold_ticks + (self._move_ticks if kind == "A" else 0)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        ticks = context.get_discrete_state(self._ticks).value()[0]
        if ticks >= 0:
            discrete_state.set_value(self._ticks, [ticks + 1])
            return
        kind, level, _ = self._parameters(context)
        if kind != "none" and self._trigger.Eval(context)[0] < level:
            discrete_state.set_value(self._ticks, [0.0])
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._onset_command, self._desired.Eval(context))

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        if not self._is_active(context):
            output.SetFromVector(self._desired.Eval(context))
            return
        command = context.get_discrete_state(self._onset_command).value()
        if self._parameters(context)[0] == "A":
            target = context.get_numeric_parameter(self._target).value()
            target = np.where(np.isnan(target), command, target)
            ticks = context.get_discrete_state(self._ticks).value()[0]
            share = min((ticks + 1) / self._move_ticks, 1.0)
            command = (1.0 - share) * command + share * target
        output.SetFromVector(command)

    def _calc_active(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._is_active(context))
