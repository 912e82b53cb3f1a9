"""The whole cycle, arrow by arrow: guard, return set, way home, reset and resumption, subtask, and the guard again.

Each arrow of the hybrid system was sampled where it is analysed: this puts the counts beside each other, each with the
bound that it allows. They are of one world and one network. They are not one experiment: the resumption is sampled from
postures that the way home leaves, at the scenes of undisturbed switching points and with cans that were taken, not with
cans that were moved or toppled on the way.
"""

import json
import math
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from diagrams.hybrid import cycle_sweep as sweep
from diagrams.hybrid.common import Arguments, fingerprint_with_analyses
from diagrams.hybrid.cycle_reports import require_counts, require_reports, require_rows
from diagrams.hybrid.return_proof import bound, holds
from diagrams.world.names import CANS
from models.checks import require_plain
from models.errors import InputError

KINDS = "none", "A", "B"  # of disturbances
FORETOLD = "way_home", "resumption"  # arrows that the sweep is compared with
LARGEST_REPORT = 100_000_000  # bytes
# May differ, and are told then: a report takes hours, and few changes of the code change what it measures.
CODES = ("code", "analyses")
SIGNIFICANT = 0.05  # p of a sweep that fails more often than an arrow
BY = "by the arm or a can in the hand (the can that was in the hand, and what it knocks over, is not seen)"


@dataclass
class Cycle(Arguments):
    """The cycle guard, return, resumption, task: each arrow with its bound, the weakest, and the dwell time."""

    sweep: Path = Path("outputs/sweep")  # folder of a sweep with the network of `resume`, under none, A and B

    NAME: ClassVar[str] = "cycle"

    def run(self) -> int:
        """Reads what `return`, `resume` and the sweep found; returns 0 if they bear the cycle out, else 1.

        That is: no arrow has failures, the certificate holds, and the sweep has runs that came home and resumed, and
        does not contradict what is foretold of both.
        """
        from diagrams.drawing.cycle import save_cycle

        returned, resumed = self._read("return"), self._read("resume")
        codes = require_one_world({
            "the world": fingerprint_with_analyses(self.loaded_world()), "return": returned.get("fingerprint"),
            "resume": resumed.get("fingerprint"), "the sweep": sweep.fingerprint(self.sweep),
        })  # fmt: skip
        sweep.require_drawn(self.sweep)
        found = report(returned, resumed, sweep.episodes(self.sweep)) | {"sweep": str(self.sweep), "codes": codes}
        self.write(found)
        save_cycle(found, self.out / "cycle.png")
        print(table(found))
        for name, of in codes.items():
            if len(set(of.values())) > 1:
                differ = ", ".join(f"{what} {code}" for what, code in of.items())
                print(f"warning: the reports differ in {name}: {differ}", file=sys.stderr)
        if reasons := against(found):
            print(f"exit code 1: {'; '.join(reasons)}")
        return 1 if reasons else 0

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


def require_one_world(fingerprints: dict[str, dict[str, Any] | None]) -> dict[str, dict[str, Any]]:
    """Raises InputError unless all, by what they are of, are of one world and of the same versions.

    Returns each of CODES, by what it is of: those may differ.
    """
    (first, reference), *others = fingerprints.items()
    if not all(isinstance(entry, dict) for entry in fingerprints.values()):
        raise InputError("a report has no fingerprint: it is of another version, run `return` and `resume` again")
    for name, entry in others:
        assert entry is not None
        assert reference is not None
        for key in sorted((reference.keys() | entry.keys()) - {*CODES}):
            if reference.get(key) != entry.get(key):
                raise InputError(
                    f"{first} and {name} differ in {key} ({reference.get(key)!s:.60}, {entry.get(key)!s:.60}): run "
                    "them in one world"
                )
    given = {name: entry for name, entry in fingerprints.items() if entry is not None}
    return {code: {name: entry[code] for name, entry in given.items() if code in entry} for code in CODES}


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
    ours = [
        row for row in rows
        if (row["weights_hash"], row["encoder_hash"]) == (resumed["policy"], resumed["encoder_hash"])
        and (row["detector"], row["gamma"]) == ("recall", None)
        and (row["success"] is not None or row["void"])  # not one that ends with the switching
    ]  # fmt: skip
    if errors := sum(row["error"] is not None for row in ours):
        raise InputError(f"{errors} episodes of the sweep raised an error: run it with --retry-errors")
    ours = [row for row in ours if not row["void"]]
    undisturbed = [row for row in ours if row["disturbance"] == "none"]
    taken = [row for row in ours if row["disturbance"] in ("A", "B")]
    disturbed = [row for row in taken if not row["false_switches"]]
    if lacking := [kind for kind in KINDS if all(row["disturbance"] != kind for row in undisturbed + disturbed)]:
        raise InputError(
            f"the sweep has no episodes under {', '.join(lacking)} of the network that `resume` looked at: run "
            "diagrams/sweep.py with it under --disturbance none A B"
        )
    arrows = _arrows(returned, resumed, undisturbed, disturbed)
    dwell, certificate_holds = _dwell(returned, disturbed), holds(returned)
    noticed = [row for row in disturbed if row["detection_delay_s"] is not None]
    home = [row for row in noticed if row["returned"]]
    way_home = _against(
        "way home", arrows, noticed, not_returned=_lost, touched=_touched, touched_can_to_pick=_touched_own
    )
    resumption = _against("reset and resumption", arrows, home, not_resumed=lambda row: not row["resumed"])
    return {
        "policy": resumed["policy"],
        "encoder_hash": resumed["encoder_hash"],
        "certificate_holds": certificate_holds,
        "switched_before": len(taken) - len(disturbed),  # disturbed runs that no arrow counts
        "rule": resumed["rule"],
        "arrows": arrows,
        # Where the most was seen to fail; of equals, the one that is known least.
        "weakest": max(arrows, key=lambda arrow: (arrow["failures"] / max(arrow["samples"], 1), arrow["bound"]))[
            "name"
        ],
        "least_known": max(arrows, key=lambda arrow: arrow["bound"])["name"],
        "way_home": way_home,
        "resumption": resumption,
        "dwell": dwell,
    }


def _lost(row: dict[str, Any]) -> bool:
    return not row["returned"]


def _touched(row: dict[str, Any]) -> bool:
    return row["way_home_m"] is not None and row["way_home_m"] <= 0.0


def _touched_own(row: dict[str, Any]) -> bool:
    """The can that was in the hand, maybe: that the ways of `return` do not count."""
    return _touched(row) and row["way_home_nearest"] == CANS[0]


def _against(
    name: str,
    arrows: Sequence[dict[str, Any]],
    rows: Sequence[dict[str, Any]],
    **wrong: Callable[[dict[str, Any]], bool],
) -> dict[str, Any]:
    """What the arrow `name` foretells, beside the `rows` of the sweep; `wrong`: in what ways one may have failed.

    `p`: of so many failures among the rows, or more, if both had one probability (Fisher's exact test, one-sided; two
    bounds beside each other would hardly ever contradict). They agree where it is at least SIGNIFICANT; of no rows
    both are None.
    """
    from scipy.stats import fisher_exact

    [arrow] = [arrow for arrow in arrows if arrow["name"] == name]
    n, failed = len(rows), sum(any(of(row) for of in wrong.values()) for row in rows)
    measured = {"samples": n, "failures": failed, "bound": bound(failed, n)}
    measured |= {which: sum(map(of, rows)) for which, of in wrong.items()}
    counts = [[failed, n - failed], [arrow["failures"], arrow["samples"] - arrow["failures"]]]
    p = float(fisher_exact(counts, alternative="greater").pvalue) if n else None
    agrees = None if p is None else p >= SIGNIFICANT
    return {"foretold_bound": arrow["bound"], "measured": measured, "p": p, "agrees": agrees}


def _arrows(
    returned: dict[str, Any],
    resumed: dict[str, Any],
    undisturbed: Sequence[dict[str, Any]],
    disturbed: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Each arrow once: its counts, and the bound that they allow; see `report`."""
    sets, kinds, draws = returned["sets"], list(resumed["rules"][resumed["rule"]].values()), returned["draws"]
    finished = [entry["finished"] for entry in kinds if entry["finished"] is not None]
    resumption, subtasks = resumed["by_scene"][resumed["rule"]], resumed["finished_by_scene"]
    closed_again = [row for row in disturbed if row["resumed"]]
    starts, late = (sum(entry[name] for entry in kinds) for name in ("samples", "not_resumed"))
    ends, undone = (sum(entry[name] for entry in finished) for name in ("samples", "failures"))
    require_counts("starts of resume.json", late, starts)
    require_counts("subtasks of resume.json", undone, ends)

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
         f"draws of an onset and a target of A: home, nothing touched {BY}"),
        ("way home, anywhere in the box", "box", "home",
         (returned["samples_inside"], sets["box"]["all"]["failed_or_touched"]),
         f"postures uniform in the box: home, nothing touched {BY}"),
        ("reset and resumption", "home", "task",
         (resumption["samples"], resumption["failures"]),
         f"scenes: from each of the starts at home there alpha falls within 6 s ({late} of {starts} starts fail)"),
        ("subtask", "task", "task",
         (subtasks["samples"], subtasks["failures"]),
         f"scenes: after each of the starts that was run to its end the subtask is done ({undone} of {ends} are not)"),
        ("no later switch", "task", "task", count(closed_again, lambda row: row["later_switches"] > 0),
         "disturbed episodes of the sweep that resumed"),
    )  # fmt: skip
    for name, _, _, (n, failures), _ in entries:
        require_counts(name, failures, n)
    return [
        {"name": name, "from": begin, "to": end, "samples": n, "failures": failures, "bound": bound(failures, n),
         "what": what}
        for name, begin, end, (n, failures), what in entries
    ]  # fmt: skip


def _dwell(returned: dict[str, Any], disturbed: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Dwell time in mode `return` that makes V fall from cycle to cycle, ln(mu) / -ln(lambda), and what was measured.

    V, the box gauge, falls by the factor lambda a tick there, but for the first, which has its own, on ways on which
    the filter changes nothing; elsewhere it rises at most from its level at home to 1. So mu is 1 / (level at home), of
    one V: not, as with Hespanha and Morse (CDC 1999), the ratio of the Lyapunov functions of two modes. A stay that
    long undoes what the task did. It is sufficient, not necessary: the mode is left at home only. Measured: from the
    end of a disturbance until the network has the arm.
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
        ticks = 1.0 + max(0.0, (math.log(mu) + math.log(first)) / -math.log(later))
        bounds[kind] = {"first": first, "lambda": later, "ticks": ticks, "seconds": ticks * period}
    measured = (
        {"stays": len(stays), "min": min(stays), "median": statistics.median(stays), "max": max(stays)}
        if stays else None
    )  # fmt: skip
    return {"mu": mu, "bounds": bounds, "measured_s": measured}


def against(found: dict[str, Any]) -> list[str]:
    """What speaks against the cycle, in words; empty where the reports and the sweep bear it out."""
    reasons = [f"failures of the arrow '{arrow['name']}'" for arrow in found["arrows"] if arrow["failures"]]
    if not found["certificate_holds"]:
        reasons.append("the certificate of `return` does not hold")
    for name in FORETOLD:
        if not found[name]["agrees"]:
            seen = "is not seen in the sweep" if found[name]["p"] is None else "fails more often in the sweep"
            reasons.append(f"what is foretold of '{name.replace('_', ' ')}' {seen}")
    return reasons


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
    for name, what in zip(FORETOLD, ("come home untouched", "resumed"), strict=True):
        foretold, seen = found[name]["foretold_bound"], found[name]["measured"]
        line = f"not {what}: foretold at most {foretold:.2e}; {seen['failures']} of {seen['samples']} disturbed runs"
        if name == "way_home":
            line += (
                f" ({seen['not_returned']} not home, {seen['touched']} touch something, {seen['touched_can_to_pick']} "
                f"of these the {CANS[0].replace('_', ' ')}, which the arrow does not count if it was in the hand)"
            )
        if found[name]["p"] is not None:
            line += f", p {found[name]['p']:.2g}" + ("" if found[name]["agrees"] else ": more often than foretold")
        lines.append(line)
    if left_out := found["switched_before"]:
        lines.append(f"left out: {left_out} disturbed runs with a false switch before the disturbance")
    if not found["certificate_holds"]:
        lines.append(
            "the certificate of `return` does not hold: its report says which way home fails, touches something, or is "
            "slower than certified"
        )
    seconds = ", ".join(f"{kind} {entry['seconds']:.1f} s" for kind, entry in dwell["bounds"].items())
    stays = dwell["measured_s"]
    seen = (
        "" if stays is None else f"; measured {stays['min']:.1f} to {stays['max']:.1f} s, median {stays['median']:.1f}"
    )
    lines.append(f"dwell time in return, ln(mu) / -ln(lambda), mu {dwell['mu']:.1f}: {seconds}{seen}")
    return "\n".join(lines)
