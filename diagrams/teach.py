"""Direct teaching, scripted: records the teacher's 200 demonstrations, as robomimic or LeRobot reads them.

    python diagrams/teach.py --out demonstrations.h5

Each demonstration is subtask 1 followed by subtask 2, in physics, for one grid position and one vacant spot. A killed
run goes on where it stopped; the same seed gives the same content. Exit code 1: a demonstration failed; 2: bad input.
"""

import dataclasses
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro

from diagrams.episodes.compatibility import of_data_sets
from diagrams.episodes.cores import cores
from diagrams.episodes.pool import MOST_WORKERS, Pool, kept_in_thread
from models.checks import LARGEST_SEED, require_numbers
from models.command_line import require, run


@dataclass
class TeachArguments:
    """Command line of teach.py."""

    out: Path  # the HDF5 file, or LeRobot's folder; an unfinished one is completed
    format: Literal["robomimic", "lerobot"] = "robomimic"  # lerobot: LeRobotDataset v3; what is trained here: robomimic
    world: Path | None = None  # YAML file of the world to teach in
    seed: int = 0  # samples how the cans are turned about their axes and how the arm is pushed off its path
    workers: int = field(default_factory=cores)  # processes; 0: this one
    limit: int | None = None  # only so many demonstrations (for trying out)


def parse(arguments: list[str] | None = None) -> TeachArguments:
    """The command line."""
    return tyro.cli(TeachArguments, args=arguments, description=__doc__)


def demonstrate(job):
    """The Recording of a World and a Setup, in a worker: its teacher is built once."""
    from diagrams.world.teacher import Teacher

    world, setup = job
    return kept_in_thread(("teacher", repr(world)), lambda: Teacher(world)).demonstrate(setup)


def main(arguments: TeachArguments) -> int:
    """Records what is missing; returns 1 if the teacher itself failed somewhere."""
    if arguments.format == "lerobot":
        require("av", "h5py", "pandas", "pyarrow", extra="files")
    from tqdm import tqdm

    from diagrams.world.scenario import load_world
    from diagrams.world.teacher import setups

    require_numbers(arguments, {"seed": (0, LARGEST_SEED), "limit": (1, 10**6), "workers": (0, MOST_WORKERS)})
    world = load_world(arguments.world)
    todo = setups(world, arguments.seed)[: arguments.limit]
    settings = {"world": dataclasses.asdict(world), "seed": arguments.seed}
    opened = _layout(arguments.format)(arguments.out, settings, of_data_sets(world))
    with Pool(arguments.workers) as pool, opened as file:
        missing = [(world, setup) for setup in todo if setup.name not in file]
        done = len(todo) - len(missing)
        recordings = pool.run(demonstrate, missing)
        for _, recording in tqdm(recordings, total=len(todo), initial=done, unit="demo", desc="teaching", disable=None):
            file.add(recording)
        content, failed = file.finish([setup.name for setup in todo])
    print(f"{len(todo) - len(failed)} of {len(todo)} demonstrations succeeded; content {content[:16]}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def _layout(name: str) -> Any:
    """The class that writes demonstrations in that layout."""
    if name == "lerobot":
        from models.data.lerobot import LeRobotFolder

        return LeRobotFolder
    from models.data.recording import RecordingFile

    return RecordingFile


if __name__ == "__main__":
    run(main, parse)
