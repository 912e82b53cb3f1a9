"""The text of requirements in signal temporal logic: a small parser for files of named formulas.

    let NAME = FORMULA          # a name for it, in what follows
    require NAME: FORMULA       # a requirement; it counts at the first tick

A comment goes from # to the end of the line. Weakest first, a FORMULA is

    A implies B | A or B | A and B | A until[I] B | A since[I] B
    not A | always[I] A | eventually[I] A | historically[I] A | once[I] A | (A) | NAME | SUM < SUM (also <=, >, >=)

and a SUM one of terms with + or - between them: a number, a signal, number * signal, or abs(SUM), which a number may
scale too. An interval [I] is [0:6 s] or [1:inf tick], how far from now; without one it is [0:inf tick].
"""

import math
import re
from collections.abc import Collection
from pathlib import Path

from models.errors import InputError
from systems.signal_logic import FUTURE, PAST, Formula, Junction, Linear, Not, Predicate, Until, Within

WORDS = {
    "let", "require", "implies", "or", "and", "until", "since", "not", "abs", "inf", "s", "tick", *FUTURE, *PAST
}  # fmt: skip
LONGEST = 10_000  # ticks, of an interval that ends
DEEPEST = 100  # brackets and operators in each other
_TOKEN = re.compile(r"\s+|#[^\n]*|(?P<token>\d+\.?\d*(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|<=|>=|[-+*<>()\[\]:=])")


def parse_requirements(text: str, signals: Collection[str], period: float, name: str) -> dict[str, Formula]:
    """The requirements in `text`, by their names, in its order.

    `signals`: names that there are; `period`: of a tick, s, to the nearest of which seconds are rounded; `name`: of
    the text, for the InputError that is raised at what does not fit, with its line.
    """
    return _Parser(text, signals, period, name).file()


def load_requirements(path: Path, signals: Collection[str], period: float) -> dict[str, Formula]:
    """Those in the file `path`, see `parse_requirements`; raises InputError where it cannot be read, too."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the requirements {path} cannot be read ({error}): give a text file in UTF-8") from error
    return parse_requirements(text, signals, period, str(path))


class _Parser:
    def __init__(self, text: str, signals: Collection[str], period: float, name: str):
        self._signals, self._period, self._name = signals, period, name
        self._tokens: list[tuple[str, int]] = []  # and their lines
        self._next = self._depth = 0
        line, place = 1, 0
        while place < len(text):
            match = _TOKEN.match(text, place)
            if match is None:
                raise self._error(f"{text[place]!r} has no meaning", line)
            if match["token"]:
                self._tokens.append((match["token"], line))
            line += match[0].count("\n")
            place = match.end()
        self._defined: dict[str, Formula] = {}

    # Reading.

    def _error(self, words: str, line: int | None = None) -> InputError:
        if line is None:  # that of the next token
            line = self._tokens[min(self._next, len(self._tokens) - 1)][1] if self._tokens else 1
        return InputError(f"{self._name}, line {line}: {words}: see systems/signal_logic_text.py for what can be said")

    def _peek(self) -> str:
        return self._tokens[self._next][0] if self._next < len(self._tokens) else ""

    def _take(self, *wanted: str) -> str | None:
        """The next token if it is one of `wanted`."""
        if (found := self._peek()) and found in wanted:
            self._next += 1
            return found
        return None

    def _expect(self, wanted: str) -> None:
        if not self._take(wanted):
            raise self._error(f"{wanted!r} should stand where {self._peek() or 'the end'!r} does")

    def _new_name(self, taken: Collection[str]) -> str:
        name = self._peek()
        if not name.isidentifier() or name in WORDS:
            raise self._error(f"a name should stand where {name or 'the end'!r} does")
        if name in taken:
            raise self._error(f"the name {name!r} is given twice")
        self._next += 1
        return name

    def _number(self, negative: bool = False) -> float:
        token = self._peek()
        if not token[:1].isdigit() or not math.isfinite(float(token)):
            raise self._error(f"a number should stand where {token or 'the end'!r} does")
        self._next += 1
        return -float(token) if negative else float(token)

    # The grammar, weakest first.

    def file(self) -> dict[str, Formula]:
        found: dict[str, Formula] = {}
        while self._peek():
            if self._take("let"):
                name = self._new_name({*self._defined, *self._signals})
                self._expect("=")
                self._defined[name] = self._formula()
            elif self._take("require"):
                name = self._new_name(found)
                self._expect(":")
                found[name] = self._formula()
            else:
                raise self._error(f"'let' or 'require' should stand where {self._peek()!r} does")
        if not found:
            raise self._error("there is no requirement in it")
        return found

    def _formula(self) -> Formula:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(f"more than {DEEPEST} brackets and operators are in each other")
        left = self._disjunction()
        if self._take("implies"):
            left = Junction(Not(left), self._formula(), either=True)
        self._depth -= 1
        return left

    def _disjunction(self) -> Formula:
        left = self._conjunction()
        while self._take("or"):
            left = Junction(left, self._conjunction(), either=True)
        return left

    def _conjunction(self) -> Formula:
        left = self._until()
        while self._take("and"):
            left = Junction(left, self._until(), either=False)
        return left

    def _until(self) -> Formula:
        left = self._unary()
        while word := self._take("until", "since"):
            first, last = self._interval()
            left = Until(left, self._unary(), first, last, past=word == "since")
        return left

    def _unary(self) -> Formula:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(f"more than {DEEPEST} brackets and operators are in each other")
        found = self._one()
        self._depth -= 1
        return found

    def _one(self) -> Formula:
        if self._take("not"):
            return Not(self._unary())
        if operator := self._take(*FUTURE, *PAST):
            first, last = self._interval()
            return Within(operator, first, last, self._unary())
        if self._take("("):
            inside = self._formula()
            self._expect(")")
            return inside
        if self._peek() in self._defined:
            self._next += 1
            return self._defined[self._tokens[self._next - 1][0]]
        return self._comparison()

    def _comparison(self) -> Predicate:
        left = self._sum()
        sign = self._take("<", "<=", ">", ">=")
        if sign is None:
            raise self._error(f"<, <=, > or >= should stand where {self._peek() or 'the end'!r} does")
        right = self._sum()
        less, more = (left, right) if sign[0] == "<" else (right, left)
        return Predicate(less, more, strict=len(sign) == 1)

    def _sum(self) -> Linear:
        negative = self._take("-") is not None
        terms = [self._term(negative)]
        while sign := self._take("+", "-"):
            terms.append(self._term(sign == "-"))
        return Linear(tuple(terms))

    def _term(self, negative: bool) -> tuple[float, str | Linear | None]:
        if not self._peek()[:1].isdigit():
            return -1.0 if negative else 1.0, self._scaled()
        factor = self._number(negative)
        return factor, self._scaled() if self._take("*") else None

    def _scaled(self) -> str | Linear:
        if self._take("abs"):
            self._expect("(")
            inside = self._sum()
            self._expect(")")
            return inside
        name = self._peek()
        if name not in self._signals:
            there = ", ".join(sorted(self._signals))
            raise self._error(f"there is no signal {name or 'the end'!r} (there are {there})")
        self._next += 1
        return name

    def _interval(self) -> tuple[int, int | None]:
        """In ticks; None: without end."""
        if not self._take("["):
            return 0, None
        first = self._number()
        self._expect(":")
        last = None if self._take("inf") else self._number()
        unit = self._take("s", "tick")
        if unit is None:
            raise self._error(f"'s' or 'tick' should stand where {self._peek() or 'the end'!r} does")
        self._expect("]")
        if last is not None and last < first:
            raise self._error(f"the interval ends, after {last:g} {unit}, before it begins, after {first:g}")
        return self._ticks(first, unit), None if last is None else self._ticks(last, unit)

    def _ticks(self, bound: float, unit: str) -> int:
        ticks = bound / self._period if unit == "s" else bound
        if ticks > LONGEST or (unit == "tick" and ticks != int(ticks)):
            raise self._error(f"the bound {bound:g} {unit} is no whole number of ticks up to {LONGEST}")
        return round(ticks)
