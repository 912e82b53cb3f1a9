"""Discrete-time signal temporal logic on arrays: by how much a run keeps a requirement (quantitative robustness).

A formula has a value at each tick: positive where it holds, negative where it does not, and as large as what it would
take to turn it. `<` and `<=` have the same value; `holds` tells them apart. Beyond the ends of the run nothing is
found and nothing is broken: eventually, once, until and since are at -infinity there, always and historically at
+infinity. These are the semantics of RTAMT (Nickovic and Yamaguchi, ATVA 2020), to which a test compares them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Signals = Mapping[str, np.ndarray]  # (n,) each, by name: a value a tick

FUTURE, PAST = ("always", "eventually"), ("historically", "once")
LEAST = ("always", "historically")  # the least value in the interval; of the others, the largest


@dataclass(frozen=True, eq=False)
class Linear:
    """A sum of terms: a factor and what it scales, which is a signal's name, an absolute value, or 1 (None)."""

    terms: tuple[tuple[float, "str | Linear | None"], ...]

    def value(self, signals: Signals) -> np.ndarray | float:
        """At each tick; a number where no signal is in it."""
        total: np.ndarray | float = 0.0
        for factor, what in self.terms:
            if what is None:
                total = total + factor
            elif isinstance(what, Linear):
                total = total + factor * np.abs(what.value(signals))
            else:
                total = total + factor * signals[what]
        return total

    def names(self) -> set[str]:
        """Of the signals in it."""
        inside = [{what} if isinstance(what, str) else what.names() for _, what in self.terms if what is not None]
        return set().union(*inside)


@dataclass(frozen=True, eq=False)
class Predicate:
    """`less` is less than `more`, or at most that where not `strict`."""

    less: Linear
    more: Linear
    strict: bool


@dataclass(frozen=True, eq=False)
class Not:
    """It is false."""

    of: "Formula"


@dataclass(frozen=True, eq=False)
class Junction:
    """Both are true; with `either`: at least one is."""

    left: "Formula"
    right: "Formula"
    either: bool


@dataclass(frozen=True, eq=False)
class Within:
    """One of FUTURE and PAST in the ticks from `first` to `last` away (None: to the end of the run)."""

    operator: str
    first: int
    last: int | None
    of: "Formula"


@dataclass(frozen=True, eq=False)
class Until:
    """`right` holds `first` to `last` ticks from now, and `left` from now until the tick before; `past`: since."""

    left: "Formula"
    right: "Formula"
    first: int
    last: int | None
    past: bool


Formula = Predicate | Not | Junction | Within | Until


def parts(formula: Formula) -> tuple[Formula, ...]:
    """The formulas directly in it."""
    if isinstance(formula, Predicate):
        return ()
    if isinstance(formula, Not | Within):
        return (formula.of,)
    return formula.left, formula.right


def signal_names(formula: Formula) -> set[str]:
    """Of all signals that it looks at."""
    if isinstance(formula, Predicate):
        return formula.less.names() | formula.more.names()
    return set().union(*map(signal_names, parts(formula)))


def robustness(formula: Formula, signals: Signals) -> np.ndarray:
    """(n,) its value at each tick of the run; of a requirement, that at tick 0 counts.

    Raises ValueError where the signals have no tick or are not of one length.
    """
    return _evaluate(formula, signals, lambda p: _difference(p, signals))


def holds(formula: Formula, signals: Signals) -> np.ndarray:
    """(n,) whether it is true at each tick: where robustness is 0, that depends on `<` or `<=`."""

    def truth(predicate: Predicate) -> np.ndarray:
        found = _difference(predicate, signals)
        return np.where((found > 0.0) | ((found == 0.0) & (not predicate.strict)), 1.0, -1.0)

    return _evaluate(formula, signals, truth) > 0.0


def _difference(predicate: Predicate, signals: Signals) -> np.ndarray:
    return np.asarray(predicate.more.value(signals) - predicate.less.value(signals))


def _evaluate(formula: Formula, signals: Signals, atom: Callable[[Predicate], np.ndarray]) -> np.ndarray:
    lengths = {len(values) for values in signals.values()}
    if len(lengths) != 1 or not (n := lengths.pop()):
        raise ValueError(f"the signals have {sorted(lengths)} ticks; each must have as many, and one at least.")
    known: dict[int, np.ndarray] = {}  # a formula that is in another twice is evaluated once

    def value(f: Formula) -> np.ndarray:
        if id(f) not in known:
            known[id(f)] = compute(f)
        return known[id(f)]

    def compute(f: Formula) -> np.ndarray:
        if isinstance(f, Predicate):
            return np.broadcast_to(atom(f), n)
        if isinstance(f, Not):
            return -value(f.of)
        if isinstance(f, Junction):
            return (np.maximum if f.either else np.minimum)(value(f.left), value(f.right))
        if isinstance(f, Within):
            sign = -1.0 if f.operator in LEAST else 1.0
            values = sign * value(f.of)
            return sign * (_largest_before(values, f) if f.operator in PAST else _largest_before(values[::-1], f)[::-1])
        if f.past:
            return _since(value(f.left), value(f.right), f)
        return _since(value(f.left)[::-1], value(f.right)[::-1], f)[::-1]

    return value(formula)


def _delayed(values: np.ndarray, ticks: int, before: float) -> np.ndarray:
    """As it was `ticks` ago; `before` the first tick."""
    count = min(ticks, len(values))
    return np.concatenate((np.full(count, before), values[: len(values) - count]))


def _largest_before(values: np.ndarray, f: Within) -> np.ndarray:
    """The largest of the ticks `first` to `last` before each."""
    if f.last is None:
        return _delayed(np.maximum.accumulate(values), f.first, -np.inf)
    padded = np.concatenate((np.full(f.last, -np.inf), values))
    windows = np.lib.stride_tricks.sliding_window_view(padded, f.last - f.first + 1)
    return windows[: len(values)].max(axis=1)


def _since(left: np.ndarray, right: np.ndarray, f: Until) -> np.ndarray:
    """`left` since `right`, which came `first` to `last` ticks before each; in time reversed, until."""
    kept = np.full(len(left), np.inf)  # the least of `left` in the ticks before
    if f.last is None:
        found, latest = np.empty(len(left)), -np.inf
        for k, (a, b) in enumerate(zip(left, right, strict=True)):
            found[k] = latest = max(b, min(a, latest))
        for age in range(min(f.first, len(left))):
            kept = np.minimum(kept, _delayed(left, age, np.inf))
        return np.minimum(kept, _delayed(found, f.first, -np.inf))
    found = np.full(len(left), -np.inf)
    for age in range(min(f.last + 1, len(left))):
        if age >= f.first:
            found = np.maximum(found, np.minimum(kept, _delayed(right, age, -np.inf)))
        kept = np.minimum(kept, _delayed(left, age, np.inf))
    return found
