"""What acts in the closed loop, compared while the runs come in; the evidence is that of the sweeps."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from diagrams.monitors.bench_plan import NEVER, NONE, Controller
from diagrams.monitors.bench_table import POOLED, Record, Rows, by_episode, came_of
from diagrams.monitors.bench_task import BenchTask
from diagrams.sweeps.sequential import DECIDED, evidence, paired, scenes_won
from systems.recoveries.registry import RECOVERIES

FIRST_LOOK = 4  # scenes; at each look twice as many as at the one before, so that diagrams are built few times


def looks(
    two: tuple[Controller, Controller], off: Sequence[BenchTask], loops: Sequence[BenchTask], rows: Rows
) -> Iterator[list[BenchTask]]:
    """The episodes `off`, fault by fault, the scenes up to the next look at a time; no more of a fault that is decided.

    `rows`: the caller has those of the `loops` of the episodes that it was given, before it asks for more.
    """
    acted, kinds = by_episode(loops), dict[tuple, dict[int, list[BenchTask]]]()
    for task in off:
        kinds.setdefault((task.kind, task.severity), {}).setdefault(task.seed, []).append(task)
    for by_scene in kinds.values():
        scenes, looked = [*by_scene.values()], 0
        while looked < len(scenes):
            end = max(2 * looked, FIRST_LOOK)
            yield [task for scene in scenes[looked:end] for task in scene]
            looked = end
            seen = (task for scene in scenes[:looked] for task in scene)
            if float(evidence(*scenes_won(_differences(two, seen, acted, rows)))) >= DECIDED:
                break


def rounds(
    two: tuple[Controller, Controller],
    off: Sequence[BenchTask],
    loops: Sequence[BenchTask],
    rows: Rows,
    missing: Sequence[BenchTask],
) -> Iterator[list[BenchTask]]:
    """Those of the `loops` that are `missing`, a look at a time."""
    for some in looks(two, off, loops, rows):
        episodes = {task.episode for task in some}
        yield [task for task in missing if task.episode in episodes]


def _differences(
    two: tuple[Controller, Controller], off: Iterable[BenchTask], acted: Mapping[tuple, BenchTask], rows: Rows
) -> Iterator[tuple[int, int]]:
    """See `scenes_won`; not of void episodes, nor of those with an error."""
    for task in off:
        if not rows[task.key].get("void"):
            came = [came_of(task, label, recovery, acted, rows) for label, recovery in two]
            if came[0] is not None and came[1] is not None:
                yield task.seed, int(came[0][0]) - int(came[1][0])


def comparisons(found: Sequence[Record], two: tuple[Controller, Controller] | None = None) -> list[Record]:
    """Each that acts against `never`, and the `two` against one another: under each fault and severity, and over all.

    Of the episodes that both have, what `paired` says. With `two` none is over all: the faults that were decided have
    fewer scenes than the others.
    """
    acting = dict.fromkeys((r["detector"], r["recovery"]) for r in found if r["success"] is not None)
    pairs = dict.fromkeys((who, (NEVER, who[1])) for who in acting if who[0] != NEVER)
    if two is not None:
        first, second = ((label, RECOVERIES.label(recovery)) for label, recovery in two)
        pairs[first, second] = None
    by: dict[Controller, dict[tuple, bool]] = {who: {} for who in acting}
    for r in found:
        if r["success"] is not None:
            episode = r["fault"], r["severity"], r["training_seed"], r["seed"]
            by[r["detector"], r["recovery"]][episode] = r["success"]
    cells = dict.fromkeys((r["fault"], r["severity"]) for r in found)
    return [
        _compared(a, b, by[a], by[b], *cell)
        for cell in (*cells, *([(POOLED, None)] if two is None else []))
        for a, b in pairs
        if a in by and b in by
    ]


def _compared(
    a: Controller, b: Controller, of_a: dict[tuple, bool], of_b: dict[tuple, bool], fault: str, severity: float | None
) -> dict[str, Any]:
    """An entry of `comparisons`."""
    both = [
        (episode[-1], int(done) - int(of_b[episode]))
        for episode, done in of_a.items()
        if episode in of_b and (episode[:2] == (fault, severity) if fault != POOLED else episode[0] != NONE)
    ]
    names = ({"detector": detector, "recovery": recovery} for detector, recovery in (a, b))
    return {"fault": fault, "severity": severity} | dict(zip("ab", names, strict=True)) | paired(both)


def comparison_text(found: Sequence[dict[str, Any]]) -> str:
    """Those over all faults, and those of a fault that is decided; a line each."""
    lines = list[str]()
    for c in found:
        if c["fault"] == POOLED or c["e"] >= DECIDED:
            a, b = (f"{c[who]['detector']} ({c[who]['recovery']})" for who in "ab")
            fault = c["fault"] if c["severity"] is None else f"{c['fault']} {c['severity']:g}"
            verdict = "decided, " if c["e"] >= DECIDED else ""
            lines.append(
                f"{fault}: {a} against {b}: of {c['scenes']} scenes {c['scenes_a']} and {c['scenes_b']}; {verdict}"
                f"e = {c['e']:.3g}"
            )
    return "\n".join(lines)
