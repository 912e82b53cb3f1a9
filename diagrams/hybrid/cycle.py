"""The whole cycle, arrow by arrow: guard, return set, way home, resumption, subtask, and the guard again.

Each arrow of the hybrid system was sampled where it is analysed: this puts the counts beside each other, each with the
bound that it allows, and names the weakest. The way home and the resumption are sampled from all states that the arrow
before may leave, which is what lets the arrows be joined.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagrams.hybrid.common import Arguments
from diagrams.hybrid.return_proof import bound
from models.errors import InputError

ROWS = "episodes.parquet"  # of a sweep


@dataclass
class Cycle(Arguments):
    """The cycle guard, return, resumption, task: each arrow with its bound, the weakest, and the dwell time."""

    sweep: Path = Path("outputs/sweep")  # folder of a sweep with the network of `resume`, under none, A and B

    def run(self) -> int:
        """Reads what `return`, `resume` and the sweep found; returns 0 if they do not contradict each other, else 1."""
        from diagrams.drawing.cycle import save_cycle

        found = report(self._read("return"), self._read("resume"), self._rows())
        self.write("cycle", found)
        save_cycle(found, self.out / "cycle.png")
        print(table(found))
        return 0 if found["resumption"]["agrees"] else 1

    def _read(self, name: str) -> dict[str, Any]:
        path = self.out / f"{name}.json"
        try:
            return dict(json.loads(path.read_text()))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{path} cannot be read: run `analysis.py {name} --out {self.out}` first, or choose another --out"
            ) from error

    def _rows(self) -> list[dict[str, Any]]:
        """The sweep's episodes with the recall as detector."""
        from models.command_line import require

        require("pandas", "pyarrow")
        import pandas as pd

        path = self.sweep / ROWS
        if not path.is_file():
            raise InputError(f"there is no {path}: give the folder of a finished sweep with --sweep")
        frame = pd.read_parquet(path)
        return [{str(name): value for name, value in row.items()} for row in frame.to_dict("records")]


def report(returned: dict[str, Any], resumed: dict[str, Any], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The cycle, plain types.

    Args:
        returned, resumed: what return.json and resume.json hold.
        rows: episodes of a sweep (see Outcome); those of the network of `resumed` are used.

    Raises InputError where a report is of another version, or the sweep lacks the network or a kind of disturbance.
    """
    try:
        rule = resumed["rules"][resumed["rule"]]
        ours = [row for row in rows if row["weights_hash"] == resumed["policy"] and row["detector"] == "recall"]
        arrows, measured = _arrows(returned, rule, ours)
        dwell = _dwell(returned, ours)
    except KeyError as error:
        raise InputError(
            f"the reports lack {error}: they are of another version, run `return`, `resume` and the sweep again"
        ) from error
    foretold = next(arrow for arrow in arrows if arrow["name"] == "resumption")
    return {
        "rule": resumed["rule"],
        "arrows": arrows,
        "weakest": max(arrows, key=lambda arrow: arrow["bound"])["name"],
        "all_bound": min(1.0, sum(arrow["bound"] for arrow in arrows)),
        "resumption": {
            "foretold_bound": foretold["bound"],
            "measured": measured,
            # What was measured is no surprise at 95 %: its lower bound is not above what was foretold at most.
            "agrees": 1.0 - bound(measured["samples"] - measured["failures"], measured["samples"]) <= foretold["bound"],
        },
        "dwell": dwell,
    }


def _arrows(
    returned: dict[str, Any], rule: dict[str, Any], rows: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The arrows; and the resumptions of the sweep's disturbed runs."""
    undisturbed = [row for row in rows if row["disturbance"] == "none"]
    disturbed = [row for row in rows if row["disturbance"] in ("A", "B") and not row["void"]]
    disturbed = [row for row in disturbed if not row["false_switches"]]
    if not undisturbed or not disturbed:
        raise InputError(
            "the sweep has no undisturbed, or no disturbed, episodes of the network that `resume` looked at: run "
            "diagrams/sweep.py with it under --disturbance none A B"
        )
    sets, subtasks = returned["sets"], list(rule.values())
    outside = sum(round((1.0 - returned[f"coverage_{kind}"]) * returned["draws"]) for kind in ("onsets", "targets"))
    finished = [entry["finished"] for entry in subtasks if entry["finished"] is not None]
    counts = (
        ("no false alarm", "task", "task", len(undisturbed), sum(bool(row["switched"]) for row in undisturbed),
         "undisturbed episodes of the sweep"),
        ("guard", "task", "return", len(disturbed), sum(_missing(row["detection_delay_s"]) for row in disturbed),
         "disturbed episodes of the sweep: noticed before the disturbance ends"),
        ("return set", "return", "box", 2 * returned["draws"], outside,
         "onset postures and targets of A: inside the certified box"),
        ("way home", "box", "home", sum(found["all"]["samples"] for found in sets.values()),
         sum(found["all"]["failures"] + found["all"]["touches"] for found in sets.values()),
         "postures of the box, onsets and targets: home, nothing touched"),
        ("resumption", "home", "task", sum(entry["samples"] for entry in subtasks),
         sum(entry["not_resumed"] for entry in subtasks), "starts at home, any memory: alpha falls within 6 s"),
        ("subtask", "task", "task", sum(entry["samples"] for entry in finished),
         sum(entry["failures"] for entry in finished), "of these, run on: the subtask is done"),
    )  # fmt: skip
    arrows = [
        {"name": name, "from": begin, "to": end, "samples": n, "failures": failures,
         "bound": bound(failures, n) if n else 1.0, "what": what}
        for name, begin, end, n, failures, what in counts
    ]  # fmt: skip
    home = [row for row in disturbed if row["returned"]]
    measured = {"samples": len(home), "failures": sum(not row["resumed"] for row in home)}
    return arrows, measured | {"bound": bound(measured["failures"], measured["samples"]) if home else 1.0}


def _dwell(returned: dict[str, Any], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Dwell time in mode `return` that makes V fall from cycle to cycle, ln(mu) / -ln(lambda), and what was measured.

    V, the box gauge, falls by the factor lambda a tick there; elsewhere it rises at most from its level at home to 1,
    that is by mu. So a stay that long undoes what the task did (Hespanha and Morse 1999, for one stay). Measured: from
    the end of a disturbance until the network has the arm.
    """
    mu = 1.0 / returned["level_at_home"]
    periods = {kind: found["time_home_certified_s"] for kind, found in returned["sets"].items()}
    stays = sorted(
        row["return_s"] + row["resume_s"]
        for row in rows
        if not _missing(row["return_s"]) and not _missing(row["resume_s"])
    )
    bounds = {
        kind: {"lambda": found["contraction_rate"], "ticks": math.log(mu) / -math.log(found["contraction_rate"])}
        for kind, found in returned["sets"].items()
    }
    middle = stays[len(stays) // 2] if stays else None
    return {
        "mu": mu, "bounds": bounds, "time_home_certified_s": periods,
        "measured_s": {"stays": len(stays), "min": stays[0], "median": middle, "max": stays[-1]} if stays else None,
    }  # fmt: skip


def _missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def table(found: dict[str, Any]) -> str:
    """The report as lines for people."""
    rows = [("arrow", "from -> to", "failures", "bound (95 %)", "")]
    for arrow in found["arrows"]:
        weakest = "weakest" if arrow["name"] == found["weakest"] else ""
        counted = f"{arrow['failures']} of {arrow['samples']}"
        rows.append((arrow["name"], f"{arrow['from']} -> {arrow['to']}", counted, f"{arrow['bound']:.2e}", weakest))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    measured, dwell = found["resumption"]["measured"], found["dwell"]
    lines.append(
        f"not resumed: foretold at most {found['resumption']['foretold_bound']:.2e}; {measured['failures']} of "
        f"{measured['samples']} disturbed runs"
    )
    ticks = ", ".join(f"{kind} {entry['ticks']:.0f}" for kind, entry in dwell["bounds"].items())
    stays = dwell["measured_s"]
    seen = (
        "" if stays is None else f"; measured {stays['min']:.1f} to {stays['max']:.1f} s, median {stays['median']:.1f}"
    )
    lines.append(f"dwell time in return, ln(mu) / -ln(lambda), mu {dwell['mu']:.1f}: ticks {ticks}{seen}")
    return "\n".join(lines)
