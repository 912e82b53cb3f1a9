"""The experimenter's hand: moves the arm away, or stops it, once in an episode (Sec. IV)."""

import math
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive, require_vector

KINDS = ("none", "A", "B", "moved")
MOVE_TICKS = 8  # duration of the move of kind A, ticks


# Not frozen, lists instead of tuples, no quoted types: Drake reads a subclass of it from YAML.
@dataclass
class DisturbanceParameters:
    """What a disturbance does, once in an episode."""

    kind: str = "none"  # none; A: the arm is moved away; B: it is stopped; moved: something else is, see below
    level: float | None = None  # it begins at the first tick at which the trigger is below, unit of the trigger
    target: list[float] | None = None  # A: where the first components are moved to, unit of the posture
    hold_ticks: int = 0  # how long the arm is held there (A) or stopped (B), or a fault acts (0: to the end), ticks
    severity: float = field(default=1.0, kw_only=True)  # of a fault, 0 to 1; see systems/faults/fault.py


class Disturbance(LeafSystem):
    """Passes the command through, except during one disturbance.

    .. pydrake_system::

        name: Disturbance
        input_ports: [desired_posture, trigger]
        output_ports: [disturbed_posture, active, ticks_since_onset]

    Inputs:
        desired_posture: (M,) command of the controller, physical units.
        trigger: (1,) what the onset is measured in, such as a distance in m; read at the ticks only.
    Outputs:
        disturbed_posture: (M,) command for the arm, physical units. Direct feedthrough of `desired_posture` alone.
        active: (1,) 1 during the disturbance, else 0. No direct feedthrough.
        ticks_since_onset: (1,) state: 0 at the onset, -1 before it.

    The onset is the first tick at which trigger < level. The command that held until then is the command at
    the onset. From that tick's update on, `disturbed_posture` is
        kind "A": on a straight line in MOVE_TICKS equal steps from the command at the onset to the target (the first
            step at once), then the target for `hold_ticks`; components without a target keep the command at the onset;
        kind "B": the command at the onset for `hold_ticks`;
        kind "moved": the input, as ever: what else is moved at the onset is told it by `ticks_since_onset` alone;
        kind "none": the input, always.
    Afterwards it is transparent again, and stays so. Ticks since the onset and the command at the onset are discrete
    state. The DisturbanceParameters are parameters of the Context, so one diagram serves all episodes.
    """

    def __init__(self, *, posture_size: int, period: float = 0.1):
        """
        Args:
            posture_size: M.
            period: of the ticks, s.
        """
        super().__init__()
        self._size = require_count("posture_size", posture_size)
        schedule, target = self._vectors(DisturbanceParameters())
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
        self.DeclareStateOutputPort("ticks_since_onset", self._ticks)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def set_parameters(self, context: Context, parameters: DisturbanceParameters) -> None:
        """Sets what an episode's disturbance does in this system's Context (not the root's); leaves its state alone.

        Raises ValueError for a kind, a level, a target or a hold that makes no disturbance.
        """
        schedule, target = self._vectors(parameters)
        context.get_mutable_numeric_parameter(self._schedule).SetFromVector(schedule)
        context.get_mutable_numeric_parameter(self._target).SetFromVector(target)

    def _ticks_since_onset(self, context: Context) -> int:
        return int(context.get_discrete_state(self._ticks)[0])

    def _vectors(self, given: DisturbanceParameters) -> tuple[list[float], np.ndarray]:
        """Number of the kind, level and hold ticks; and the target (M,), NaN where there is none."""
        if given.kind not in KINDS:
            raise ValueError(f"kind is {given.kind!r}; it must be one of {', '.join(KINDS)}: pass one of them.")
        level = 0.0 if given.kind == "none" and given.level is None else given.level
        if level is None or math.isnan(level):
            raise ValueError(f"level is {level}; it must be a number: pass the level that starts the disturbance.")
        if given.kind == "A" and given.target is None:
            raise ValueError("target is None; kind 'A' moves the arm to it: pass a posture.")
        target = np.full(self._size, np.nan)
        if given.target is not None:
            count = min(len(given.target), self._size)
            target[:count] = require_vector("target", given.target, count)
        hold_ticks = require_count("hold_ticks", given.hold_ticks, 1 if given.kind == "B" else 0)
        return [float(KINDS.index(given.kind)), float(level), float(hold_ticks)], target

    def _schedule_of(self, context: Context) -> tuple[str, float, float]:
        number, level, hold_ticks = context.get_numeric_parameter(self._schedule).value()
        return KINDS[int(number)], level, hold_ticks

    def _is_active(self, context: Context) -> bool:
        ticks = self._ticks_since_onset(context)
        if ticks < 0:
            return False
        kind, _, hold_ticks = self._schedule_of(context)
        return kind in ("A", "B") and ticks < hold_ticks + (MOVE_TICKS if kind == "A" else 0)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        ticks = self._ticks_since_onset(context)
        if ticks >= 0:
            discrete_state.set_value(self._ticks, [ticks + 1])
            return
        kind, level, _ = self._schedule_of(context)
        if kind != "none" and self._trigger.Eval(context)[0] < level:
            discrete_state.set_value(self._ticks, [0.0])
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._onset_command, self._desired.Eval(context))

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        if not self._is_active(context):
            output.SetFromVector(self._desired.Eval(context))
            return
        command = context.get_discrete_state(self._onset_command).value()
        if self._schedule_of(context)[0] == "A":
            target = context.get_numeric_parameter(self._target).value()
            target = np.where(np.isnan(target), command, target)
            ticks = self._ticks_since_onset(context)
            share = min((ticks + 1) / MOVE_TICKS, 1.0)
            command = (1.0 - share) * command + share * target
        output.SetFromVector(command)

    def _calc_active(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._is_active(context))
