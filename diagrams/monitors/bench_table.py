"""What the rows of the bench say: a record an episode, detector and recovery; cells of these; tables of the cells."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.monitors.bench_plan import NONE, ORACLE
from diagrams.monitors.bench_task import BenchTask
from diagrams.monitors.families import FAMILIES, family_of
from diagrams.monitors.metrics import Monitored, contingency, labels, measured, severity_noticed_by_half
from diagrams.monitors.scoring import largest_before
from diagrams.world.faults.registry import kind_label
from models.files.container import whole_file
from systems.recoveries.registry import RECOVERIES

TABLE = "bench.parquet"
# Of a cell, in this order. Those of NOTICED are of the cell's episodes and the undisturbed ones of the same scenes,
# without which nothing would be there that no alarm is needed in; the others of its episodes alone.
FIELDS = (
    "tasks", "tpr", "tnr", "balanced_accuracy", "auroc", "auprc", "twa", "detection_s", "false_alarms_per_hour",
    "seconds_lost", "net_benefit", "gap_closed",
)  # fmt: skip
JUDGED = ("tpr", "tnr", "balanced_accuracy", "auroc", "auprc", "twa")  # by what is to be noticed
NOTICED = (*JUDGED, "false_alarms_per_hour")
POOLED = "pooled"

CELL = ("detector", "fault", "severity", "recovery")
Record = dict[str, Any]  # see `records`
Rows = Mapping[str, dict[str, Any]]


def records(
    off: Sequence[BenchTask],
    loops: Sequence[BenchTask],
    rows: Rows,
    recoveries: Sequence[str],
    period: float,
    acting: Collection[str] | None = None,
) -> list[Record]:
    """One for each detector, recovery and episode with the detector off; not of void ones, nor of those with an error.

    An episode in which a detector does not alarm is that with the detector off. `period`: of the ticks, s. Of
    detectors that are not in `acting` (None: all are) nobody knows what comes of it: `success`, `lost_s` and `label`
    are None.
    """
    acted, found = by_episode(loops), list[Record]()
    for task in off:
        row = rows[task.key]
        if row["error"] is not None or row["void"]:
            continue
        never = bool(row["success"])
        for recovery in recoveries:
            oracle = came_of(task, ORACLE, recovery, acted, rows)
            for scored in task.detectors:
                own = came_of(task, scored.label, recovery, acted, rows)
                if own is None or oracle is None:
                    continue
                said, onset = row["detectors"][scored.label], row["onset"]
                acts = (*task.episode, scored.label, recovery) in acted
                known = acting is None or scored.label in acting
                needless = acts and never and own[0]
                found.append(
                    {
                        "detector": scored.label,
                        "fault": kind_label(task.kind),
                        "family": None if task.kind == NONE else family_of(task.kind),
                        "severity": task.severity,
                        "recovery": RECOVERIES.label(recovery),
                        "rnn": task.rnn,
                        "training_seed": task.training_seed,
                        "seed": task.seed,
                        "onset_s": None if onset is None else onset * period,
                        "alarm_s": None if said["alarm"] is None else said["alarm"] * period,
                        "false_alarms": said["false_alarms"],
                        "normal_s": (row["ticks"] if onset is None else onset) * period,
                        "ticks": row["ticks"],
                        "length_s": row["ticks"] * period,
                        "needed": not never,
                        "success": own[0] if known else None,
                        "oracle_success": oracle[0] if acting is None or ORACLE in acting else None,
                        "lost_s": (max(own[1] - row["ticks"] * period, 0.0) if needless else 0.0) if known else None,
                        "peaks": said["peaks"],
                        "weights_hash": task.weights_hash,
                        "off": task.key,
                        "acts": acts,
                        "label": None,
                    }
                )
    looped = [record for record in found if record["success"] is not None]
    for record, label in zip(looped, labels(monitored(looped)).tolist() if looped else (), strict=True):
        record["label"] = label
    return found


def by_episode(loops: Iterable[BenchTask]) -> dict[tuple, BenchTask]:
    """Those of the closed loop by episode, short name of the detector, and recovery."""
    return {(*task.episode, task.detectors[0].label, task.recovery): task for task in loops}


def came_of(
    off: BenchTask, label: str, recovery: str, acted: Mapping[tuple, BenchTask], rows: Rows
) -> tuple[bool, float] | None:
    """Success, and seconds in the loop (0: it did not act); None: it raised an error, or was not run.

    `acted`: see `by_episode`. A detector that did not alarm had no run of its own: what came of it is that of `off`.
    """
    loop = acted.get((*off.episode, label, recovery))
    row = rows.get((loop or off).key)
    if row is None or row["error"] is not None:
        return None
    return bool(row["success"]), 0.0 if loop is None else row["sim_seconds"]


def monitored(found: Sequence[Record]) -> Monitored:
    """The arrays that the metrics are of, of detectors that all act, or none; the scores cut at the shortest run."""
    shortest = min((record["ticks"] for record in found), default=0)

    def column(name: str, kind: type) -> np.ndarray:
        return np.array([np.nan if record[name] is None else record[name] for record in found], kind)

    def came(name: str) -> np.ndarray | None:
        return None if any(record[name] is None for record in found) else column(name, bool)

    return Monitored(
        scene=column("seed", int), training_seed=column("training_seed", int),
        score=np.array([largest_before(record["peaks"], shortest) for record in found]),
        onset=column("onset_s", float), alarm=column("alarm_s", float), false_alarms=column("false_alarms", int),
        normal_time=column("normal_s", float), length=column("length_s", float), needed=column("needed", bool),
        success=came("success"), oracle_success=came("oracle_success"), lost=column("lost_s", float),
    )  # fmt: skip


def cells(found: Sequence[Record]) -> list[Record]:
    """One for each detector, fault, severity and recovery, in the order of the records: FIELDS, see `measured`.

    Of a detector that does not act in closed loop what is of the loop is None.
    """
    return [_cell(own, base) for own, base in _groups(found, CELL, found)]


def pooled(found: Sequence[Record]) -> list[Record]:
    """The same of all faults and severities together, and of each family: one for each detector and recovery."""
    disturbed = [r for r in found if r["fault"] != NONE]
    families = [[r for r in disturbed if r["family"] == family] for family in FAMILIES]
    return [
        _cell(own, base) | {"fault": name, "severity": None}
        for name, some in zip((POOLED, *FAMILIES), (disturbed, *families), strict=True)
        for own, base in _groups(some, ("detector", "recovery"), found)
    ]


def _groups(
    found: Sequence[Record], names: tuple[str, ...], everything: Sequence[Record] = ()
) -> Iterator[tuple[list[Record], list[Record]]]:
    """Records alike in `names`; and the undisturbed ones of their detector and recovery, where `everything` is given.

    Those are no others than they where they are undisturbed themselves.
    """
    groups: dict[tuple, list[Record]] = {}
    for record in found:
        groups.setdefault(tuple(record[name] for name in names), []).append(record)
    for own in groups.values():
        same = own[0]["detector"], own[0]["recovery"]
        undisturbed = [r for r in everything if r["fault"] == NONE and (r["detector"], r["recovery"]) == same]
        yield own, undisturbed if own[0]["fault"] != NONE else []


def _cell(own: list[Record], base: list[Record]) -> dict[str, Any]:
    everyone = monitored([*own, *base])
    alone = measured(monitored(own), names=[name for name in FIELDS if name not in NOTICED])
    values = alone | measured(everyone, names=NOTICED)
    labelled = {name: own[0][name] for name in CELL} | {"n": len(own)}
    labelled |= {name: values.get(name) for name in FIELDS}
    return labelled | {"disturbed": measured(everyone, "disturbed", JUDGED)}


def flat(cell: Record) -> Record:
    """A cell without entries within entries: `disturbed_tpr` and its like."""
    inner = {f"disturbed_{name}": value for name, value in cell["disturbed"].items()}
    return {name: value for name, value in cell.items() if name != "disturbed"} | inner


def worth(found: Sequence[Record]) -> list[Record]:
    """How often each label of an alarm, or of a silence, and by whether there was a fault, and what came of it.

    None where the detector does not act in closed loop.
    """
    return [
        {name: own[0][name] for name in CELL}
        | {"labels": None if own[0]["label"] is None else contingency(monitored(own))}
        for own, _ in _groups(found, CELL)
    ]


def half_noticed(found: Sequence[Record]) -> list[Record]:
    """The severity at which half is noticed, of each detector and fault with several severities."""
    first = [record for record in found if record["recovery"] == found[0]["recovery"]]  # it is of the runs without
    entries = []
    for own, _ in _groups([record for record in first if record["severity"] is not None], ("detector", "fault")):
        severity = np.array([record["severity"] for record in own])
        if len(np.unique(severity)) > 1:
            runs = monitored(own)
            value = severity_noticed_by_half(severity, runs.noticed, runs.scene)
            entries.append({"detector": own[0]["detector"], "fault": own[0]["fault"], "severity": value})
    return entries


def write_table(folder: Path, found: Sequence[Record]) -> Path:
    """Writes the records, but for what only the bench and its explorer need, as a table in `folder`; its name."""
    import pandas as pd

    path = folder / TABLE
    without = ("peaks", "off", "acts")
    rows = [{name: value for name, value in record.items() if name not in without} for record in found]
    with whole_file(path) as partial:
        pd.DataFrame(rows).to_parquet(partial, index=False)
    return path


COLUMNS = {
    "tasks": "tasks", "tpr": "TPR", "tnr": "TNR", "balanced_accuracy": "bal.acc", "auroc": "AUROC", "auprc": "AUPRC",
    "twa": "TWA", "detection_s": "seen s", "false_alarms_per_hour": "false/h", "seconds_lost": "lost s",
    "net_benefit": "net", "gap_closed": "gap",
}  # fmt: skip


def text(summary: Mapping[str, Any]) -> str:
    """The pooled faults, a line a detector and recovery; the tasks done, detectors by recoveries; and by fault."""
    cells, everything = summary["cells"], [cell for cell in summary["pooled"] if cell["fault"] == POOLED]
    recoveries = list(dict.fromkeys(cell["recovery"] for cell in everything))
    detectors = list(dict.fromkeys(cell["detector"] for cell in everything or cells))
    width = max(map(len, detectors)) + 2
    lines = [f"{'all faults':{width}s}{'recovery':10s}{'n':>6s}" + "".join(f"{w:>9s}" for w in COLUMNS.values())]
    for cell in everything:
        lines.append(f"{cell['detector']:{width}s}{cell['recovery']:10s}{cell['n']:6d}{_line(cell, COLUMNS)}")
    first = recoveries[0]
    seen = {(c["fault"], c["detector"]): c["disturbed"] for c in summary["pooled"] if c["recovery"] == first}
    lines += ["", f"{'the fault noticed':{width}s}" + "".join(f"{COLUMNS[name]:>9s}" for name in JUDGED)]
    lines[-1] += "".join(f"{f'AUROC, {family}':>26s}" for family in FAMILIES)
    for name in detectors:
        lines.append(f"{name:{width}s}{_line(seen.get((POOLED, name), {}), JUDGED)}")
        lines[-1] += "".join(_line(seen.get((family, name), {}), ("auroc",), 26) for family in FAMILIES)
    acting = [cell for cell in cells if cell["tasks"] is not None]
    acts = [name for name in detectors if any(cell["detector"] == name for cell in acting)]
    tasks = {(cell["detector"], cell["recovery"]): with_interval(cell["tasks"]) for cell in everything}
    lines += ["", f"{'tasks done':{width}s}" + "".join(f"{name:>21s}" for name in recoveries)]
    for detector in acts:
        lines.append(f"{detector:{width}s}" + "".join(f"{tasks[detector, name]:>21s}" for name in recoveries))
    done = {(c["fault"], c["severity"], c["detector"]): c["tasks"]["value"] for c in acting if c["recovery"] == first}
    lines += ["", f"{'tasks done, ' + first:24s}" + "".join(f"{_short(name):>9s}" for name in acts)]
    for fault, severity in dict.fromkeys(key[:2] for key in done):
        name = fault if severity is None else f"{fault} {severity:g}"
        shares = (done.get((fault, severity, detector)) for detector in acts)
        lines.append(f"{name:24s}" + "".join(f"{'-' if s is None else _number(s):>9s}" for s in shares))
    lines += ["", "All with 95 % intervals over scenes, fault by fault: summary.json."]
    return "\n".join(lines)


def _line(cell: Mapping[str, Any], names: Iterable[str], width: int = 9) -> str:
    """Values of a cell by these names, `width` characters each."""
    found = (cell.get(name) for name in names)
    return "".join(f"{'-' if entry is None else _number(entry['value']):>{width}s}" for entry in found)


def _short(name: str) -> str:
    return name if len(name) <= 8 else name[:7] + "."


def _number(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 100.0 else f"{value:.0f}"


def with_interval(entry: dict[str, Any] | None) -> str:
    """An entry of a cell in words."""
    if entry is None:
        return "-"
    low, high = map(_number, entry["interval"])
    return f"{_number(entry['value'])} [{low}, {high}]"
