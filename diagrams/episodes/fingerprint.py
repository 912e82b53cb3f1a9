"""What decides the rows of a run that is resumed: world, code and definitions. Those of another are not mixed."""

import dataclasses
import functools
import hashlib
from importlib.metadata import version
from typing import Any

from diagrams.world.configuration import World
from models.command_line import ROOT

# What an episode's outcome depends on: the definitions of success among it.
ROOMS: tuple[str, ...] = (
    "sdf", "systems", "diagrams/world", "models/inference.py", "models/policy.py", "models/files",
    "models/data/scaling.py", "models/data/windows.py", *(f"diagrams/episodes/{name}.py" for name in (
        "branching", "calibration", "controller", "episode", "outcome", "prefix", "record", "rollout", "run_log",
        "runner", "sampling", "space", "switching", "way_home",
    )),
)  # fmt: skip

VERSIONS = ("drake", "numpy", "onnxruntime", "opencv-python-headless")  # of these packages: they decide the bits


@functools.cache
def code_hash(*rooms: str) -> str:
    """SHA-256 (16 hexadecimal digits) of the sources in ROOMS and in further `rooms`."""
    total = hashlib.sha256()
    for room in (ROOT / name for name in (*ROOMS, *rooms)):
        for path in [room] if room.is_file() else sorted(room.rglob("*")):
            if path.suffix in (".py", ".sdf", ".yaml", ".xml", ".stl"):
                total.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return total.hexdigest()[:16]


def fingerprint(world: World, *rooms: str, **more: Any) -> dict[str, Any]:
    """Plain types: the world's entries by name, the code with further `rooms`, and what else decides the rows."""
    entries: dict[str, Any] = {}
    for name, value in dataclasses.asdict(world).items():
        parts = {f".{part}": entry for part, entry in value.items()} if isinstance(value, dict) else {"": value}
        entries |= {f"world.{name}{part}": entry for part, entry in parts.items()}
    return {"code": code_hash(*rooms)} | {name: version(name) for name in VERSIONS} | entries | more
