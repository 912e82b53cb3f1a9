"""Every state of the hybrid system: which system owns it, how large it is, how often it changes."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import ClassVar

from pydrake.systems.framework import Context, Diagram, System

from diagrams.hybrid.common import NetworkArguments

KINDS = ("continuous", "discrete", "abstract")


@dataclass
class States(NetworkArguments):
    """Every state of the hybrid system, and that they are all; and the graph of the diagram."""

    NAME: ClassVar[str] = "states"

    def run(self) -> int:
        """Lists the states; returns 0 if their sums are those of the root Context, else 1."""
        from diagrams.drawing.graph import graph_program, save_graph

        graph_program()  # refused before anything is written
        rollout, episode = self.closed_loop()
        rollout.prepare(episode)
        found = report(rollout.diagram, rollout.simulator.get_context())
        self.write(found)
        for form in ("svg", "png"):
            save_graph(rollout.diagram, self.out / f"graph.{form}")
        print(table(found))
        return 0 if found["agree"] else 1


@dataclass(frozen=True)
class State:
    """One state: `owner` is the system's path in the root Diagram, `index` counts the owner's states of that kind."""

    owner: str
    system: str
    kind: str
    index: int
    size: int  # numbers of a continuous or discrete state, 1 for an abstract one
    period: float | None  # s; None where the system declares no single one


def states_of(system: System, root: Context, path: str = "") -> Iterator[State]:
    """The states in `system`, in the order of the diagram; `root`: Context of the root Diagram."""
    if isinstance(system, Diagram):
        for part in system.GetSystems():
            yield from states_of(part, root, f"{path}/{part.get_name()}".lstrip("/"))
        return
    context, name = system.GetMyContextFromRoot(root), type(system).__name__
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    period = None if timing is None else float(timing.period_sec())
    if context.num_continuous_states():
        yield State(path, name, "continuous", 0, context.num_continuous_states(), None)
    for i in range(context.num_discrete_state_groups()):
        yield State(path, name, "discrete", i, context.get_discrete_state(i).size(), period)
    for i in range(context.num_abstract_states()):
        yield State(path, name, "abstract", i, 1, None)


def report(diagram: Diagram, context: Context) -> dict:
    """The list, its sums, those of the root Context, and whether they agree; plain types."""
    states = list(states_of(diagram, context))
    sums = {kind: sum(state.size for state in states if state.kind == kind) for kind in KINDS}
    sums["discrete_groups"] = sum(state.kind == "discrete" for state in states)
    groups = context.num_discrete_state_groups()
    root = {
        "continuous": context.num_continuous_states(),
        "discrete": sum(context.get_discrete_state(i).size() for i in range(groups)),
        "abstract": context.num_abstract_states(),
        "discrete_groups": groups,
    }
    return {"states": [asdict(state) for state in states], "sums": sums, "root_context": root, "agree": sums == root}


def table(found: dict) -> str:
    """The report as lines for people."""
    rows = [("owner", "system", "kind", "size", "period (s)")]
    for s in found["states"]:
        period = "" if s["period"] is None else f"{s['period']:g}"
        rows.append((s["owner"], s["system"], s["kind"], str(s["size"]), period))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    sums, verdict = found["sums"], "agrees" if found["agree"] else "does not agree"
    together = ", ".join(f"{sums[kind]} {kind}" for kind in KINDS)
    return "\n".join([*lines, f"together {together}, in {sums['discrete_groups']} groups; the root Context {verdict}"])
