"""A signal that changes at given ticks and is constant between them: what a person did, or is told to do, when."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.arguments import require_count, require_positive

Points = list[tuple[int, tuple[float, ...]]]  # tick, and the values from that tick on; ticks rise


class SignalSchedule(LeafSystem):
    """A piecewise constant signal.

    .. pydrake_system::

        name: SignalSchedule
        output_ports: [signal]

    Outputs:
        signal: (n,) the values of the last change at or before the tick k = floor(t / T); before the first one, those
            of the constructor. Known at the tick itself, before its updates.

    The changes are a parameter of the Context. One that is made at a tick which has not begun leaves what was before
    as it was: a run in which changes are added as it goes, and one that has them all from the start, are the same.
    """

    def __init__(self, *, initial: Sequence[float], period: float = 0.1):
        """
        Args:
            initial: (n,) the values before the first change; they may be NaN.
            period: T of the ticks, s.
        """
        super().__init__()
        self._initial = tuple(float(value) for value in initial)
        self._size = require_count("the size of initial", len(self._initial))
        self._period = require_positive("period", period)
        self._points = self.DeclareAbstractParameter(AbstractValue.Make([]))
        reads = {self.time_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("signal", self._size, self._calc_signal, reads)

    def points(self, context: Context) -> Points:
        """The changes in this system's `context`."""
        return list(context.get_abstract_parameter(self._points).get_value())

    def set_points(self, context: Context, points: Sequence[tuple[int, Sequence[float]]]) -> None:
        """Puts these changes into this system's `context`, in place of those that it has.

        Raises ValueError unless the ticks rise from 0 on and each change has n values, none of them infinite.
        """
        made: Points = []
        for tick, values in points:
            made.append((require_count("tick", tick, made[-1][0] + 1 if made else 0), self._values(values)))
        context.get_mutable_abstract_parameter(self._points).set_value(made)

    def change(self, context: Context, tick: int, values: Sequence[float]) -> None:
        """Changes the signal from `tick` on, whatever was to come at that tick or later; see `set_points`."""
        change = require_count("tick", tick, 0), self._values(values)
        points = context.get_mutable_abstract_parameter(self._points).get_mutable_value()
        del points[bisect_left(points, tick, key=lambda point: point[0]) :]
        points.append(change)

    def _values(self, values: Sequence[float]) -> tuple[float, ...]:
        if len(values) != self._size or np.isinf(values).any():
            raise ValueError(f"values are {values}; they must be {self._size} numbers, none infinite: pass such ones.")
        return tuple(float(value) for value in values)

    def _calc_signal(self, context: Context, output: BasicVector) -> None:
        # At a tick, t / T is k but for rounding.
        tick = math.floor(context.get_time() / self._period + 1e-6)
        points = context.get_abstract_parameter(self._points).get_value()
        last = bisect_right(points, tick, key=lambda point: point[0]) - 1
        output.SetFromVector(np.array(points[last][1] if last >= 0 else self._initial))
