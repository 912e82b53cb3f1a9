"""What every fault shares: a severity, an onset, a duration, and chance that a seed decides."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.disturbance import DisturbanceParameters


@dataclass(frozen=True)
class Setting:
    """What a fault's system is built for."""

    posture_size: int  # M: joints, then fingers
    joints: int  # J
    period: float  # of the ticks, s
    width: int  # of the camera's picture, pixels
    height: int
    bodies: dict[str, tuple[BodyIndex, np.ndarray]]  # by "hand" and "elbow": body of the plant, point in its frame, m


class Fault(LeafSystem):
    """A fault of the arm, its sensors or its surroundings. It acts from the tick after its onset on.

    Every fault has the input `ticks_since_onset` (1), see Disturbance, and the output `acting` (1): 1 while it acts,
    else 0. What else it reads and gives it names after the signal: an output `faulty_posture` takes the place of the
    signal `posture`, and so on (diagrams/world/faults/wiring.py lists the signals). Severity, duration and seed are
    parameters of the Context; at severity 0 every signal passes through as it is.

    A class says of itself
        name: by which it is asked for;
        severity_1: what severity 1 is, in physical units, for people;
        acts_on: the signal or the thing that it changes, for people;
        lasts: whether it acts from the onset to the end of the run; else for as many ticks as it is told;
        shortens: whether a smaller severity shortens the time that it acts, and nothing else;
        subtask: the one in which it begins; None: either;
        from_start: whether it begins with the run;
        takes_arm: whether somebody takes the arm while it acts;
        targets: how many postures the arm is moved to, one after the other;
        needs: ports that the station has only where a fault asks for them.
    """

    name: ClassVar[str]
    severity_1: ClassVar[str]
    acts_on: ClassVar[str]
    lasts: ClassVar[bool] = True
    shortens: ClassVar[bool] = False
    subtask: ClassVar[int | None] = None
    from_start: ClassVar[bool] = False
    takes_arm: ClassVar[bool] = False
    targets: ClassVar[int] = 0
    needs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, setting: Setting):
        super().__init__()
        self._setting = setting
        self._given = self.DeclareNumericParameter(BasicVector([0.0, 0.0, 0.0]))  # severity, ticks, seed
        self._onset = self.DeclareVectorInputPort("ticks_since_onset", 1)
        self._declare_acting()

    def _declare_acting(self) -> None:
        self.DeclareVectorOutputPort("acting", 1, self._calc_acting, {self._onset.ticket(), self.pn_ticket()})

    def set_parameters(self, context: Context, given: DisturbanceParameters, seed: int) -> None:
        """Sets what the fault does in this system's Context (not the root's).

        Args:
            given: its `severity`, and `hold_ticks`, for how many ticks it acts; 0: to the end.
            seed: of everything that is random about it.

        Raises ValueError for a severity outside of [0, 1].
        """
        if not 0.0 <= given.severity <= 1.0:
            raise ValueError(f"severity is {given.severity}; it must be from 0 to 1: pass such a number.")
        ticks = given.hold_ticks
        if self.shortens:
            ticks = math.ceil(given.severity * ticks - 1e-9)
        # A double counts to 2^53.
        context.get_mutable_numeric_parameter(self._given).SetFromVector([given.severity, ticks, seed % 2**53])

    def severity(self, context: Context) -> float:
        """In this system's Context."""
        return float(context.get_numeric_parameter(self._given)[0])

    def _ticks(self, context: Context) -> int:
        """Since the onset; negative before it."""
        return int(self._onset.Eval(context)[0])

    def _strength(self, context: Context) -> float:
        """The severity while the fault acts, else 0."""
        severity, lasts, _ = context.get_numeric_parameter(self._given).value()
        ticks = self._ticks(context)
        return float(severity) if ticks >= 0 and (lasts == 0.0 or ticks < lasts) else 0.0

    def _chance(self, context: Context, tick: int = 0) -> np.random.Generator:
        """Of this episode, or of this tick of it: by seed and counter, so that there is no state."""
        seed = int(context.get_numeric_parameter(self._given)[2])
        return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, tick, 0]))

    def _calc_acting(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._strength(context) > 0.0)
