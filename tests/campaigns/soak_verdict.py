"""Whether what a soak is to keep to held, of the rows of its parts."""

import hashlib
from typing import Any

WARM = 1 / 6  # of a part, until its memory is to be flat: ten minutes of an hour
HOUR_FLAT, SWEEP_FLAT = 0.02, 0.05  # by how much the memory may still grow


def growth(measured: list[float]) -> float:
    """By what share the memory is larger than where it should be flat from on."""
    flat = measured[max(0, round(WARM * len(measured)) - 1) :]
    return max(flat) / flat[0] - 1.0


def judged(minutes: int, rows: dict[str, dict[str, Any]]) -> dict[str, tuple[bool, str]]:
    """What is asked for: whether it held, and in words what was found; `minutes`: of each of the two runs."""
    held: dict[str, tuple[bool, str]] = {}
    for name, row in rows.items():
        if "error" in row:
            held[f"{name}: runs to its end"] = False, row["error"]
            continue
        if "faults" in row:
            _judge_faults(held, name, row["faults"])
            continue
        if name == "sweep":
            count, *shown = row["errors"]
            held[f"{name}: no error"] = not count, f"{count} of {row['episodes']} episodes {shown}"
            flat = SWEEP_FLAT
        else:
            held[f"{name}: runs to its end"] = row["diverged"] is None, str(row["diverged"] or f"{row['ticks']} ticks")
            number, least = sum(row["disturbances"].values()), 1000 * minutes // 60
            held[f"{name}: enough disturbances"] = number >= least, f"{number} {row['disturbances']}"
            _judge_limits(held, name, row["found"])
            flat = HOUR_FLAT
        if measured := row["megabytes"]:
            grown = growth(measured)
            words = f"{100 * grown:.2f} % from {measured[0]:.0f} MB at first, {measured[-1]:.0f} MB at last"
            held[f"{name}: memory flat to {100 * flat:.0f} %"] = grown <= flat, words
    for what, first, second in (("the two runs", "first run", "second run"), ("the faults", "faults", "faults again")):
        digests = [_digest(rows[name]) for name in (first, second)]
        same = digests[0] == digests[1] and digests[0] is not None
        held[f"{what} are the same"] = same, ", ".join(str(digest)[:16] for digest in digests)
    return held


def _digest(row: dict[str, Any]) -> str | None:
    """Of a long run, or of those of all faults."""
    if "faults" not in row:
        return row.get("digest")
    return hashlib.sha256("".join(each["digest"] for each in row["faults"].values()).encode()).hexdigest()


def _judge_limits(held: dict[str, tuple[bool, str]], name: str, found: dict[str, list[Any]]) -> None:
    for what, (count, *shown) in found.items():
        held[f"{name}: {what}"] = not count, f"{count} ticks outside {shown}"


def _judge_faults(held: dict[str, tuple[bool, str]], name: str, rows: dict[str, dict[str, Any]]) -> None:
    """As a long run, all faults together; each of them is to have begun."""
    ended = {kind: row["diverged"] for kind, row in rows.items() if row["diverged"]}
    held[f"{name}: run to their end"] = not ended, str(ended or f"{sum(row['ticks'] for row in rows.values())} ticks")
    idle = [kind for kind, row in rows.items() if not row["ticks_acted"]]
    held[f"{name}: each one acts"] = not idle, ", ".join(idle) or f"{len(rows)} faults"
    found: dict[str, list[Any]] = {}
    for kind, row in rows.items():
        for what, (count, *shown) in row["found"].items():
            sums = found.setdefault(what, [0])
            sums[0] += count
            sums.extend(f"{kind}, {words}" for words in shown)
    _judge_limits(held, name, found)
