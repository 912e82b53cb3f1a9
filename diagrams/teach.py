"""Direct teaching, scripted: records the teacher's 200 demonstrations into one HDF5 file in robomimic's layout.

    python diagrams/teach.py --out demonstrations.h5

Each demonstration is subtask 1 followed by subtask 2, in physics, for one grid position and one vacant spot. A killed run goes on where it
stopped; the same seed gives the same content.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.names import SPOTS
from models.errors import InputError

LAYOUT_VERSION = 2


@dataclass
class TeachArguments:
    """Command line of teach.py."""

    out: Path  # the HDF5 file; an unfinished one is completed
    seed: int = 0  # draws how the cans are turned about their axes and how the arm is pushed off its way
    workers: int = os.cpu_count() or 1  # processes
    limit: int | None = None  # only so many demonstrations (for trying out)


@dataclass(frozen=True)
class Lesson:
    """One demonstration to give."""

    index: int
    grid_index: tuple[int, int]
    vacant: str
    training: bool
    turn: float  # of the can to pick about its axis, rad
    deviation_seed: tuple[int, int]  # draws how the arm is pushed off its way


def lessons(world: World, seed: int) -> list[Lesson]:
    """All positions times both spots, in a fixed order."""
    turns = np.random.default_rng(seed).uniform(-np.pi, np.pi, 2 * world.grid.count**2)
    cells = [(i, j) for i in range(world.grid.count) for j in range(world.grid.count)]
    return [
        Lesson(n, cell, vacant, world.grid.is_training(*cell), float(turns[n]), (seed, n))
        for n, (cell, vacant) in enumerate((cell, vacant) for cell in cells for vacant in SPOTS)
    ]


class Teacher:
    """The station with the scripted teacher; built once a process, reused with fresh contexts."""

    def __init__(self, world: World):
        from pydrake.systems.analysis import Simulator

        from diagrams.world.inverse_kinematics import HandKinematics
        from diagrams.world.names import ARM_JOINTS
        from diagrams.world.station import PickPlaceStation

        self.world = world
        self.station = PickPlaceStation(world)
        self.simulator = Simulator(self.station)
        self.hand = HandKinematics(world.initial_posture[:ARM_JOINTS])

    def give(self, lesson: Lesson) -> dict:
        """Runs one lesson; returns rgb (T,112,112,3), posture (T,8), actions (T,8), can_xy, success."""
        from diagrams.world import trajectory as demonstration
        from diagrams.world.names import CAN_HALF_HEIGHT
        from diagrams.world.task import TaskMonitor

        world, station, simulator = self.world, self.station, self.simulator
        can_xy = world.grid.position(*lesson.grid_index)
        place = station.spot(lesson.vacant)
        neighbour = station.spot(next(s for s in SPOTS if s != lesson.vacant))
        monitor = TaskMonitor(place, neighbour, world.initial_posture)
        goals = (np.array([*can_xy, CAN_HALF_HEIGHT]), place)
        ways = [demonstration.subtask_waypoints(world, self.hand, goal, n + 1) for n, goal in enumerate(goals)]
        rng = np.random.default_rng(lesson.deviation_seed)
        parts = list(zip(ways, demonstration.SUBTASK_STEPS, strict=True))
        actions = np.vstack([demonstration.commands(way, steps) for way, steps in parts])
        commanded = actions + np.vstack([demonstration.deviations(way, steps, rng) for way, steps in parts])
        simulator.reset_context(station.CreateDefaultContext())
        context = simulator.get_mutable_context()
        station.set_scene(context, can_xy, lesson.vacant, lesson.turn)
        desired = station.GetInputPort("desired_posture")
        desired.FixValue(context, world.initial_posture)
        simulator.Initialize()
        postures, images = [], []
        for k, command in enumerate(commanded):
            simulator.AdvanceTo(k * world.timing.period)
            postures.append(station.GetOutputPort("posture").Eval(context))
            images.append(station.GetOutputPort("rgb_image").Eval(context).data[:, :, :3].copy())
            desired.FixValue(context, command)
        simulator.AdvanceTo(len(actions) * world.timing.period)
        success = monitor.success(
            station.GetOutputPort("can_poses").Eval(context), station.GetOutputPort("posture").Eval(context)
        )
        return {
            "rgb": np.array(images),
            "posture": np.array(postures),
            "actions": actions,
            "can_xy": can_xy,
            "success": success,
            "margin_deg": float(np.rad2deg(np.min([self.hand.margin(a[:-1]) for a in commanded]))),
        }


_teacher: Teacher | None = None


def _give(world: World, lesson: Lesson) -> tuple[Lesson, dict]:
    global _teacher
    # With the first lesson, not by the pool's initializer, whose errors never reach the parent.
    _teacher = _teacher or Teacher(world)
    return lesson, _teacher.give(lesson)


def _write(file, lesson: Lesson, demo: dict) -> None:
    name = f"demo_{lesson.index}"
    partial = f"partial_{lesson.index}"
    if partial in file:  # left by a kill in the middle of a write
        del file[partial]
    group = file.create_group(partial)
    for key, array in (("obs/rgb", demo["rgb"]), ("obs/posture", demo["posture"]), ("actions", demo["actions"])):
        group.create_dataset(
            key, data=array, compression="gzip", compression_opts=1, chunks=(min(32, len(array)), *array.shape[1:])
        )
    from diagrams.world.trajectory import SUBTASK_STEPS

    group.attrs.update(
        num_samples=len(demo["actions"]),
        can_xy=demo["can_xy"],
        vacant=lesson.vacant,
        grid_index=lesson.grid_index,
        subtask_starts=(0, SUBTASK_STEPS[0]),
        split="train" if lesson.training else "valid",
        success=demo["success"],
    )
    file.move(partial, f"data/{name}")
    file.flush()


def content_hash(file) -> str:
    """Hash of every demonstration's arrays and attributes, in order: equal for equal content, however it was written."""
    digest = hashlib.sha256()
    data = file["data"]
    for name in sorted(data, key=lambda n: int(n.split("_")[1])):
        digest.update(name.encode())
        for key in ("obs/rgb", "obs/posture", "actions"):
            digest.update(np.ascontiguousarray(data[name][key][()]).tobytes())
        digest.update(json.dumps({k: np.asarray(v).tolist() for k, v in sorted(data[name].attrs.items())}).encode())
    return digest.hexdigest()


def main(arguments: TeachArguments) -> int:
    """Records what is missing; returns 1 if the teacher itself failed somewhere."""
    import h5py
    from tqdm import tqdm

    for name, least in (("seed", 0), ("workers", 1), ("limit", 1)):
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise InputError(f"--{name} {value} is too small: choose {least} or more")
    try:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{arguments.out} cannot be written ({error.strerror}): choose another --out") from error
    world = World()
    todo = lessons(world, arguments.seed)[: arguments.limit]
    settings = json.dumps(
        {"world": dataclasses.asdict(world), "seed": arguments.seed, "layout": LAYOUT_VERSION}, sort_keys=True
    )
    try:
        file = h5py.File(arguments.out, "a")
    except OSError as error:
        raise InputError(
            f"{arguments.out} cannot be opened as HDF5 ({error}): if a kill in the middle of a write broke it, delete it"
        ) from error
    with file:
        data = file.require_group("data")
        if data.attrs.get("env_args", settings) != settings:
            raise InputError(
                f"{arguments.out} was recorded with another seed or another world: delete it or choose another --out"
            )
        data.attrs.update(
            env_args=settings,
            initial_posture=world.initial_posture,
            period=world.timing.period,
            posture_names=json.dumps([f"joint_{j + 1}" for j in range(7)] + ["opening"]),
            seed=arguments.seed,
        )
        file.flush()  # from here on a killed run leaves a file that can be opened
        missing = [lesson for lesson in todo if f"demo_{lesson.index}" not in data]
        if missing:
            pool = ProcessPoolExecutor(arguments.workers, mp_context=multiprocessing.get_context("spawn"))
            try:
                futures = [pool.submit(_give, world, lesson) for lesson in missing]
                for future in tqdm(
                    as_completed(futures),
                    total=len(todo),
                    initial=len(todo) - len(missing),
                    unit="demo",
                    desc="teaching",
                ):
                    _write(file, *future.result())
            finally:
                pool.shutdown(cancel_futures=True)
        names = [f"demo_{lesson.index}" for lesson in todo]
        failed = [name for name in names if not data[name].attrs["success"]]
        if "mask" in file:
            del file["mask"]
        for split in ("train", "valid"):
            file[f"mask/{split}"] = np.array([n.encode() for n in names if data[n].attrs["split"] == split])
        data.attrs["total"] = int(sum(data[n].attrs["num_samples"] for n in names))
        data.attrs["content_hash"] = content_hash(file)
        print(
            f"{len(names) - len(failed)} of {len(names)} demonstrations succeeded; content {data.attrs['content_hash'][:16]}"
        )
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    import tyro

    try:
        sys.exit(main(tyro.cli(TeachArguments)))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
