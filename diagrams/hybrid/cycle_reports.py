"""What the cycle reads in the reports of `return` and `resume` and in a sweep, checked before it is used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from diagrams.hybrid.return_proof import KINDS
from models.errors import InputError

LARGEST = 1e12  # of a number that is read


@dataclass(frozen=True)
class Kind:
    """What a value has to be, in words, and whether one is that."""

    words: str
    fits: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    # No isfinite: a whole number beyond any float is an error there.
    return isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST < value < LARGEST


NUMBER = Kind("a number", _is_number)
NUMBER_OR_NONE = Kind("a number or null", lambda value: value is None or _is_number(value))
POSITIVE = Kind("a number above 0", lambda value: _is_number(value) and value > 1e-12)
SECONDS = Kind("a number from 0 on, or null", lambda value: value is None or (_is_number(value) and value >= 0))
SHARE = Kind("a number between 0 and 1", lambda value: _is_number(value) and 1e-12 < value < 1.0)
COUNT = Kind("a whole number from 0 on", lambda value: _is_number(value) and value == int(value) >= 0)
SOME = Kind("a whole number from 1 on", lambda value: COUNT.fits(value) and value > 0)
FLAG_OR_NONE = Kind("true, false or nothing", lambda value: value in (True, False, None))
WORD = Kind("a word", lambda value: isinstance(value, str))
WORD_OR_NONE = Kind("a word or nothing", lambda value: value is None or isinstance(value, str))

# A key "*": each there is, at least one.
_SETS = {
    "*": {
        "all": dict.fromkeys(("failures", "left_box", "touches", "failed_or_touched"), COUNT),
        "free": dict.fromkeys(
            (
                "contraction_first_measured",
                "contraction_first_over",
                "contraction_rate_measured",
                "max_v_increase",
            ),
            NUMBER,
        )
        | {"samples": COUNT, "later_than_certified": COUNT},
        "contraction_first": POSITIVE, "contraction_rate": SHARE, "nearest_distance_m": NUMBER_OR_NONE,
        "nearest_foot_m": NUMBER_OR_NONE,
        "v_tolerance": NUMBER,
    }
}  # fmt: skip
RETURNED = {
    "level_at_home": SHARE, "period_s": POSITIVE, "draws": SOME, "draws_outside": COUNT,
    "draws_failed_or_touched": COUNT, "samples_inside": SOME, "sets": _SETS,
}  # fmt: skip
FINISHED = {"samples": SOME, "failures": COUNT}
RESUMED = {
    "policy": WORD, "encoder_hash": WORD, "rule": WORD, "by_scene": {"*": FINISHED}, "finished_by_scene": FINISHED,
    "rules": {"*": {"*": {"samples": SOME, "not_resumed": COUNT}}},
}  # fmt: skip
ROW = {"way_home_m": NUMBER_OR_NONE, "way_home_nearest": WORD_OR_NONE} | dict.fromkeys(
    ("detection_delay_s", "return_s", "resume_s"), SECONDS
)
ROW |= dict.fromkeys(("success", "void", "returned", "resumed", "switched"), FLAG_OR_NONE)
# Of every row, whatever came of it.
COLUMNS = (
    "weights_hash",
    "encoder_hash",
    "detector",
    "gamma",
    "disturbance",
    "error",
    "false_switches",
    "later_switches",
    *ROW,
)


def require_reports(returned: dict[str, Any], resumed: dict[str, Any]) -> None:
    """Raises InputError unless the two hold what is read of them."""
    _require(returned, RETURNED, "return.json")
    if absent := [kind for kind in KINDS if kind not in returned["sets"]]:
        _refuse(f"return.json has no sets.{absent[0]}")
    for kind, found in returned["sets"].items():
        if not found["contraction_rate"] <= found["contraction_first"] <= 1.0:
            _refuse(f"return.json {kind} contraction_first is not from contraction_rate to 1")
    _require(resumed, RESUMED, "resume.json")
    for name in ("rules", "by_scene"):
        if resumed["rule"] not in resumed[name]:
            _refuse(f"resume.json has no {name}.{resumed['rule']}")
    for kind, entry in resumed["rules"][resumed["rule"]].items():
        if entry.get("finished") is not None:
            _require(entry["finished"], FINISHED, f"resume.json {kind}.finished")
        elif "finished" not in entry:
            _refuse(f"resume.json has no {kind}.finished")


def require_rows(rows: Sequence[dict[str, Any]]) -> None:
    """Raises InputError unless each row of a sweep has the columns that are read, and what a finished one has."""
    for number, row in enumerate(rows):
        if absent := [name for name in COLUMNS if name not in row]:
            _refuse(f"the sweep's table has no column {', '.join(absent)}")
        if row["error"] is None:
            _require(row, ROW, f"row {number} of the sweep's table")
            for name in ("false_switches", "later_switches"):
                if row[name] is not None and not COUNT.fits(row[name]):
                    _refuse(f"row {number} of the sweep's table has the {name} {row[name]!s:.60}, not {COUNT.words}")


def require_counts(name: str, failures: int, samples: int) -> None:
    """Raises InputError for more failures than samples of the arrow `name`."""
    if failures > samples:
        _refuse(f"{failures} of {samples} fail on the arrow '{name}'")


def _require(value: Any, shape: Any, where: str) -> None:
    if isinstance(shape, Kind):
        if not shape.fits(value):
            _refuse(f"{where} is {value!s:.60}, not {shape.words}")
        return
    if not isinstance(value, dict) or not value:
        _refuse(f"{where} is {value!s:.60}, not a map")
    for key, inner in shape.items():
        for name in value if key == "*" else [key]:
            if name not in value:
                _refuse(f"{where} has no {name}")
            _require(value[name], inner, f"{where} {name}")


def _refuse(what: str) -> None:
    raise InputError(f"the reports do not fit ({what}): run `return`, `resume` and the sweep again, of one version")
