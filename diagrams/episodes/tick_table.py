"""Where the time of a tick goes, by Python's own profiler: the diagram runs as without it, to the bit."""

import cProfile
import pstats
from pathlib import Path

from models.command_line import ROOT

Function = tuple[str, int, str]  # file, line, name, as pstats has them

PLANT, CONTROLLER, REST = "plant", "rest of the controller", "rest"
# What is called from a file of systems/, with all that it calls in turn.
CALLED = {
    ("systems/image_encoder.py", "Eval"): "rendering",
    ("systems/image_encoder.py", "encode"): "encoding",
    ("systems/recurrent_policy.py", "step"): "network",
}
# The profiler does not see the functions of newer Drakes (1.58): their time is that of the function that calls them.
OWN = {
    ("systems/image_encoder.py", "_calc_features"): "rendering",
    ("diagrams/episodes/rollout.py", "advance"): PLANT,
}
# The last three: detector, mixing, regulator; physics, Drake's framework, the 3-D recording; scoring, record, words.
PARTS = (*dict.fromkeys(CALLED.values()), CONTROLLER, PLANT, REST)


def tick_times(profiler: cProfile.Profile, ticks: int) -> dict[str, float]:
    """Seconds a tick that each of PARTS takes, of `ticks` that a Rollout ran, its start and end included."""
    stats = pstats.Stats(profiler).stats  # type: ignore[attr-defined]

    def part(function: Function, caller: Function, seen: tuple[Function, ...] = ()) -> str:
        file, name = _file(function), function[2].rstrip(">}").split(".")[-1]
        if (called := CALLED.get((_file(caller), name))) is not None:
            return called
        if name == "AdvanceTo":
            return PLANT
        if (own := OWN.get((file, name))) is not None:
            return own
        if file.startswith(("systems/", "diagrams/")):
            return CONTROLLER if file.startswith("systems/") else REST
        # Of a library, or of the networks: the part of who asked for it, and most for it.
        callers = stats[caller][4]
        if not callers or caller in seen:
            return REST
        return part(caller, max(callers, key=lambda other: stats[other][3]), (*seen, caller))

    seconds = dict.fromkeys(PARTS, 0.0)
    for function, (_, _, own, _, callers) in stats.items():
        for caller, (_, _, own_there, _) in callers.items():
            seconds[part(function, caller)] += own_there
        if not callers:
            seconds[REST] += own
    return {name: value / ticks for name, value in seconds.items()}


def tick_table(profiler: cProfile.Profile, ticks: int) -> str:
    """`tick_times` in words: a line a part, ms a tick and its share, and the sum."""
    times = tick_times(profiler, ticks)
    rows = [*times.items(), ("tick", whole := sum(times.values()))]
    return "\n".join(f"{name:24s}{1e3 * time:8.2f} ms{time / whole:7.0%}" for name, time in rows)


def _file(function: Function) -> str:
    """The file of `function` in this project, such as systems/detector.py; else empty."""
    path = Path(function[0])
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""
