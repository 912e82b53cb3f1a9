"""Signal temporal logic, tick by tick: the robustness of a run so far, in memory that does not grow.

A requirement that is a combination (not, and, or, implies) of always and eventually without an interval, of formulas
of the past, is at tick 0 of the run so far what its past form is now, with historically for always and once for
eventually. A formula of the past needs no more than its operators' last values.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from models.errors import InputError
from systems.signal_logic import FUTURE, LEAST, PAST, Formula, Junction, Linear, Not, Predicate, Until, Within, parts

# Of one formula: the values of those before it, the memory before and after this tick, the signals -> its value.
_Step = Callable[[list[float], list[float], list[float], list[float]], float]


def past_form(formula: Formula) -> Formula | None:
    """What `formula` at the first tick is at the last one; None where that needs what is not past."""

    def rewrite(f: Formula) -> Formula | None:
        if isinstance(f, Within) and f.operator in FUTURE and (f.first, f.last) == (0, None) and _is_past(f.of):
            return Within(PAST[FUTURE.index(f.operator)], 0, None, f.of)
        if isinstance(f, Not) and (inside := rewrite(f.of)) is not None:
            return Not(inside)
        if isinstance(f, Junction):
            left, right = rewrite(f.left), rewrite(f.right)
            return None if left is None or right is None else Junction(left, right, f.either)
        return None

    return rewrite(formula)


def _is_past(formula: Formula) -> bool:
    ahead = isinstance(formula, Within) and formula.operator in FUTURE
    return not ahead and not (isinstance(formula, Until) and not formula.past) and all(map(_is_past, parts(formula)))


class OnlineRobustness:
    """Formulas, made ready to be told a tick at a time; it remembers nothing itself.

    Attributes:
        initial: (m,) the memory before the first tick.
    """

    def __init__(self, requirements: Mapping[str, Formula], signals: Sequence[str]):
        """`signals`: names of what `step` is told; raises InputError for a requirement that looks ahead."""
        self._places = {name: i for i, name in enumerate(signals)}
        self._steps: list[_Step] = []
        self._known: dict[int, int] = {}  # number of the step of a formula that is in several
        memory: list[float] = []
        self._kept = []  # the past forms: while they are there, no other formula has the id of one
        for name, formula in requirements.items():
            past = past_form(formula)
            if past is None:
                raise InputError(
                    f"the requirement {name} cannot be watched: make it a combination of always and eventually, "
                    "without intervals, of formulas of the past"
                )
            self._kept.append(past)
        self._asked = [self._add(past, memory) for past in self._kept]
        self.initial = np.array(memory)

    def step(self, memory: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The robustness (R,) of each requirement with the signals `row` (S,) of one more tick; the memory (m,)."""
        before, values = memory.tolist(), [0.0] * len(self._steps)
        after, signals = list(before), row.tolist()
        for i, step in enumerate(self._steps):
            values[i] = step(values, before, after, signals)
        return np.array([values[i] for i in self._asked]), np.array(after)

    def _add(self, f: Formula, memory: list[float]) -> int:
        """The number of the step of `f`, which is added where it is new; what it remembers goes to `memory`."""
        if id(f) in self._known:
            return self._known[id(f)]
        inside = [self._add(part, memory) for part in parts(f)]
        place = len(memory)
        if isinstance(f, Predicate):
            step = self._predicate(f)
        elif isinstance(f, Not):
            step = _not(inside[0])
        elif isinstance(f, Junction):
            step = _junction(f, inside[0], inside[1])
        elif isinstance(f, Within):
            sign = -1.0 if f.operator in LEAST else 1.0
            if f.last is None:
                step = _largest(sign, f.first, inside[0], place)
            else:
                step = _largest_within(sign, f.first, f.last, inside[0], place)
            memory += [-np.inf] * (f.first + 1 if f.last is None else f.last)
        elif f.last is None:
            step = _since(f.first, inside[0], inside[1], place)
            memory += [-np.inf] * (f.first + 1) + [np.inf] * f.first  # of the result, and of the left
        else:
            step = _since_within(f.first, f.last, inside[0], inside[1], place)
            memory += [-np.inf] * f.last + [np.inf] * f.last  # of the right, and of the left
        self._steps.append(step)
        self._known[id(f)] = len(self._steps) - 1
        return self._known[id(f)]

    def _predicate(self, f: Predicate) -> _Step:
        less, more = self._linear(f.less), self._linear(f.more)
        return lambda values, before, after, signals: more(signals) - less(signals)

    def _linear(self, linear: Linear) -> Callable[[list[float]], float]:
        terms = [
            (factor, self._linear(what) if isinstance(what, Linear) else None if what is None else self._places[what])
            for factor, what in linear.terms
        ]

        def value(signals: list[float]) -> float:
            total = 0.0  # added in the order of Linear.value, for the same bits
            for factor, what in terms:
                if what is None:
                    total = total + factor
                elif isinstance(what, int):
                    total = total + factor * signals[what]
                else:
                    total = total + factor * abs(what(signals))
            return total

        return value


def _not(i: int) -> _Step:
    return lambda values, before, after, signals: -values[i]


def _junction(f: Junction, i: int, j: int) -> _Step:
    of = max if f.either else min
    return lambda values, before, after, signals: of(values[i], values[j])


def _largest(sign: float, first: int, i: int, place: int) -> _Step:
    def step(values: list[float], before: list[float], after: list[float], signals: list[float]) -> float:
        recent = [sign * values[i], *before[place : place + first]]  # now, a tick ago ...
        after[place : place + first] = recent[:first]
        largest = max(before[place + first], recent[first])  # of all that is `first` ticks old
        after[place + first] = largest
        return sign * largest

    return step


def _largest_within(sign: float, first: int, last: int, i: int, place: int) -> _Step:
    def step(values: list[float], before: list[float], after: list[float], signals: list[float]) -> float:
        recent = [sign * values[i], *before[place : place + last]]
        after[place : place + last] = recent[:last]
        return sign * max(recent[first:])

    return step


def _since(first: int, i: int, j: int, place: int) -> _Step:
    def step(values: list[float], before: list[float], after: list[float], signals: list[float]) -> float:
        latest = max(values[j], min(values[i], before[place]))  # had it no first bound
        results = [latest, *before[place : place + first]]
        left = [values[i], *before[place + first + 1 : place + 2 * first + 1]]
        after[place : place + 2 * first + 1] = [*results, *left[:first]]
        return min([results[first], *left[:first]])

    return step


def _since_within(first: int, last: int, i: int, j: int, place: int) -> _Step:
    def step(values: list[float], before: list[float], after: list[float], signals: list[float]) -> float:
        right = [values[j], *before[place : place + last]]
        left = [values[i], *before[place + last : place + 2 * last]]
        after[place : place + 2 * last] = [*right[:last], *left[:last]]
        found, kept = -np.inf, np.inf
        for age in range(last + 1):
            if age >= first:
                found = max(found, min(kept, right[age]))
            kept = min(kept, left[age])
        return found

    return step
