"""The whole cycle, arrow by arrow: guard, return set, way home, reset and resumption, subtask, and the guard again.

Each arrow of the hybrid system was sampled where it is analysed: this puts the counts beside each other, each with the
bound that it allows. They are of one world and one network. They are not one experiment: the resumption is sampled from
postures that the way home leaves, at the scenes of undisturbed switching points and with cans that were taken, not with
cans that were moved or toppled on the way.
"""

import json
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.store import FIRST
from diagrams.hybrid.common import Arguments
from diagrams.hybrid.cycle_reports import require_counts, require_reports, require_rows
from diagrams.hybrid.return_proof import bound, holds
from models.checks import require_plain
from models.errors import InputError

EPISODES, ROWS = "episodes.parquet", "rows.jsonl"  # of a sweep
FORETOLD = "way_home", "resumption"  # arrows that the sweep is compared with
LARGEST_REPORT = 100_000_000  # bytes
CODE = "code"  # may differ between the reports: a page that is mended changes none of them


@dataclass
class Cycle(Arguments):
    """The cycle guard, return, resumption, task: each arrow with its bound, the weakest, and the dwell time."""

    sweep: Path = Path("outputs/sweep")  # folder of a sweep with the network of `resume`, under none, A and B

    NAME: ClassVar[str] = "cycle"

    def run(self) -> int:
        """Reads what `return`, `resume` and the sweep found; returns 0 if they bear the cycle out, else 1.

        That is: the certificate holds, and the sweep does not contradict what is foretold of way home and resumption.
        """
        from diagrams.drawing.cycle import save_cycle

        returned, resumed = self._read("return"), self._read("resume")
        require_one_world({"the world": fingerprint(self.loaded_world()), "return": returned.get("fingerprint"),
                           "resume": resumed.get("fingerprint"), "the sweep": self._fingerprint()})  # fmt: skip
        found = report(returned, resumed, self._rows())
        self.write(found)
        save_cycle(found, self.out / "cycle.png")
        print(table(found))
        return 0 if found["certificate_holds"] and all(found[name]["agrees"] for name in FORETOLD) else 1

    def _read(self, name: str) -> dict[str, Any]:
        path = self.out / f"{name}.json"
        try:
            require_plain(path, largest=LARGEST_REPORT)
            report = json.loads(path.read_text())
            if not isinstance(report, dict) or "seed" not in report:
                raise ValueError("no report")
            seed = report["seed"]
        except (OSError, RecursionError, ValueError) as error:
            raise InputError(
                f"{path} cannot be read: run `analysis.py {name} --out {self.out}` first, or choose another --out"
            ) from error
        if seed != self.seed:
            raise InputError(f"{path} is of the seed {seed}: give that as --seed, here {self.seed}")
        return report

    def _fingerprint(self) -> dict[str, Any]:
        """Of the sweep."""
        path = self.sweep / ROWS
        try:
            require_plain(path)
            with path.open("rb") as file:
                line = file.readline(LARGEST_REPORT)
            if not line.startswith(FIRST):
                raise ValueError("no fingerprint")
            return dict(json.loads(line)["fingerprint"])
        except (OSError, RecursionError, TypeError, ValueError) as error:
            raise InputError(f"{path} is no sweep's: give the folder of a finished one with --sweep") from error

    def _rows(self) -> list[dict[str, Any]]:
        """The sweep's episodes, without what is missing in them."""
        from models.command_line import require

        require("pandas", "pyarrow")
        import pandas as pd

        path = self.sweep / EPISODES
        if not path.is_file():
            raise InputError(f"there is no {path}: give the folder of a finished sweep with --sweep")
        try:
            frame = pd.read_parquet(path)
        except Exception as error:  # pyarrow has a dozen, of strange bytes
            raise InputError(f"{path} cannot be read: run the sweep's command again, it makes it anew") from error
        return [
            {
                str(name): None if pd.isna(value) else value
                for name, value in row.items()
                if pd.api.types.is_scalar(value)
            }
            for row in frame.to_dict("records")
        ]


def require_one_world(fingerprints: dict[str, dict[str, Any] | None]) -> None:
    """Raises InputError unless all, by what they are of, are of one world and of the same versions."""
    (first, reference), *others = fingerprints.items()
    if not all(isinstance(entry, dict) for entry in fingerprints.values()):
        raise InputError("a report has no fingerprint: it is of another version, run `return` and `resume` again")
    for name, entry in others:
        assert entry is not None
        assert reference is not None
        for key in sorted((reference.keys() | entry.keys()) - {CODE}):
            if reference.get(key) != entry.get(key):
                raise InputError(
                    f"{first} and {name} differ in {key} ({reference.get(key)!s:.60}, {entry.get(key)!s:.60}): run "
                    "them in one world"
                )


def report(returned: dict[str, Any], resumed: dict[str, Any], rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The cycle, plain types.

    Args:
        returned, resumed: what return.json and resume.json hold.
        rows: episodes of a sweep (see Outcome), None where there is no value; those of the network of `resumed` with
            its own gamma, run to the end of the task, are used.

    Raises InputError where a report is of another version, an episode raised an error, or the sweep lacks the network
    or a kind of disturbance.
    """
    require_reports(returned, resumed)
    require_rows(rows)
    rule = resumed["rules"][resumed["rule"]]
    ours = [
        row for row in rows
        if (row["weights_hash"], row["detector"], row["gamma"]) == (resumed["policy"], "recall", None)
        and (row["success"] is not None or row["void"])  # not one that ends with the switching
    ]  # fmt: skip
    if errors := sum(row["error"] is not None for row in ours):
        raise InputError(f"{errors} episodes of the sweep raised an error: run it with --retry-errors")
    undisturbed = [row for row in ours if row["disturbance"] == "none"]
    disturbed = [row for row in ours if row["disturbance"] in ("A", "B") and not row["void"]]
    disturbed = [row for row in disturbed if not row["false_switches"]]
    if not undisturbed or not disturbed:
        raise InputError(
            "the sweep has no undisturbed, or no disturbed, episodes of the network that `resume` looked at: run "
            "diagrams/sweep.py with it under --disturbance none A B"
        )
    arrows = _arrows(returned, rule, undisturbed, disturbed)
    dwell, certificate_holds = _dwell(returned, disturbed), holds(returned)
    noticed = [row for row in disturbed if row["detection_delay_s"] is not None]
    home = [row for row in noticed if row["returned"]]
    way_home = _against("way home", arrows, noticed, "returned")
    resumption = _against("reset and resumption", arrows, home, "resumed")
    return {
        "certificate_holds": certificate_holds,
        "rule": resumed["rule"],
        "arrows": arrows,
        # Where the most was seen to fail; of equals, the one that is known least.
        "weakest": max(arrows, key=lambda arrow: (arrow["failures"] / arrow["samples"], arrow["bound"]))["name"],
        "least_known": max(arrows, key=lambda arrow: arrow["bound"])["name"],
        "way_home": way_home,
        "resumption": resumption,
        "dwell": dwell,
    }


def _against(name: str, arrows: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]], right: str) -> dict[str, Any]:
    """What the arrow `name` foretells, beside the `rows` of the sweep of which `right` says how they went."""
    foretold = {arrow["name"]: arrow["bound"] for arrow in arrows}[name]
    n, failed = len(rows), sum(not row[right] for row in rows)
    at_least = 1.0 - bound(n - failed, n) if n else 0.0
    measured = {"samples": n, "failures": failed, "at_least": at_least, "bound": bound(failed, n) if n else 1.0}
    return {"foretold_bound": foretold, "measured": measured, "agrees": at_least <= foretold}


def _arrows(
    returned: dict[str, Any],
    rule: dict[str, Any],
    undisturbed: Sequence[dict[str, Any]],
    disturbed: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Each arrow once: its counts, and the bound that they allow."""
    sets, kinds, draws = returned["sets"], list(rule.values()), returned["draws"]
    finished = [entry["finished"] for entry in kinds if entry["finished"] is not None]
    resumed = [row for row in disturbed if row["resumed"]]

    def count(rows: Sequence[dict[str, Any]], wrong: Callable[[dict[str, Any]], bool]) -> tuple[int, int]:
        return len(rows), sum(map(wrong, rows))

    entries = (
        ("no false alarm", "task", "task", count(undisturbed, lambda row: bool(row["switched"])),
         "undisturbed episodes of the sweep"),
        ("guard", "task", "return", count(disturbed, lambda row: row["detection_delay_s"] is None),
         "disturbed episodes of the sweep: noticed before the disturbance ends"),
        ("return set", "return", "box", (draws, returned["draws_outside"]),
         "draws of an onset and a target of A: inside the certified box"),
        ("way home", "box", "home", (draws, returned["draws_failed_or_touched"]),
         "draws of an onset and a target of A: home, nothing touched"),
        ("way home, anywhere in the box", "box", "home",
         (returned["samples_inside"], sets["box"]["all"]["failed_or_touched"]),
         "postures uniform in the box: home, nothing touched"),
        ("reset and resumption", "home", "task",
         (sum(entry["samples"] for entry in kinds), sum(entry["not_resumed"] for entry in kinds)),
         "starts at home: alpha falls within 6 s"),
        ("subtask", "task", "task",
         (sum(entry["samples"] for entry in finished), sum(entry["failures"] for entry in finished)),
         "starts that resumed, one a scene and kind: the subtask is done"),
        ("no later switch", "task", "task", count(resumed, lambda row: row["later_switches"] > 0),
         "disturbed episodes of the sweep that resumed"),
    )  # fmt: skip
    for name, _, _, (n, failures), _ in entries:
        require_counts(name, failures, n)
    return [
        {"name": name, "from": begin, "to": end, "samples": n, "failures": failures, "bound": bound(failures, n),
         "what": what}
        for name, begin, end, (n, failures), what in entries if n
    ]  # fmt: skip


def _dwell(returned: dict[str, Any], disturbed: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Dwell time in mode `return` that makes V fall from cycle to cycle, ln(mu) / -ln(lambda), and what was measured.

    V, the box gauge, falls by the factor lambda a tick there, but for the first, which has its own; elsewhere it rises
    at most from its level at home to 1, that is by mu. A stay that long undoes what the task did (Hespanha and Morse,
    CDC 1999, for one stay). It is sufficient, not necessary: the mode is left at home only. Measured: from the end of a
    disturbance until the network has the arm.
    """
    mu, period = 1.0 / returned["level_at_home"], returned["period_s"]
    stays = [
        row["return_s"] + row["resume_s"]
        for row in disturbed
        if row["return_s"] is not None and row["resume_s"] is not None
    ]
    bounds = {}
    for kind, found in returned["sets"].items():
        first, later = found["contraction_first"], found["contraction_rate"]
        ticks = 1.0 + (math.log(mu) + math.log(first)) / -math.log(later)
        bounds[kind] = {"first": first, "lambda": later, "ticks": ticks, "seconds": ticks * period}
    measured = (
        {"stays": len(stays), "min": min(stays), "median": statistics.median(stays), "max": max(stays)}
        if stays else None
    )  # fmt: skip
    return {"mu": mu, "bounds": bounds, "measured_s": measured}


def table(found: dict[str, Any]) -> str:
    """The report as lines for people."""
    rows = [("arrow", "from -> to", "failures", "bound (95 %)", "")]
    for arrow in found["arrows"]:
        words = [word for word in ("weakest", "least_known") if arrow["name"] == found[word]]
        counted = f"{arrow['failures']} of {arrow['samples']}"
        remark = ", ".join(words).replace("_", " ")
        rows.append((arrow["name"], f"{arrow['from']} -> {arrow['to']}", counted, f"{arrow['bound']:.2e}", remark))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    dwell = found["dwell"]
    lines += [
        f"not {what}: foretold at most {found[name]['foretold_bound']:.2e}; {found[name]['measured']['failures']} of "
        f"{found[name]['measured']['samples']} disturbed runs"
        for name, what in zip(FORETOLD, ("come home", "resumed"), strict=True)
    ]
    if not found["certificate_holds"]:
        lines.append(
            "the certificate of `return` does not hold: its report says which way home fails or touches something"
        )
    seconds = ", ".join(f"{kind} {entry['seconds']:.1f} s" for kind, entry in dwell["bounds"].items())
    stays = dwell["measured_s"]
    seen = (
        "" if stays is None else f"; measured {stays['min']:.1f} to {stays['max']:.1f} s, median {stays['median']:.1f}"
    )
    lines.append(f"dwell time in return, ln(mu) / -ln(lambda), mu {dwell['mu']:.1f}: {seconds}{seen}")
    return "\n".join(lines)
