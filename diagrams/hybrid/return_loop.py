"""The way home by itself: the closed loop in mode `return` on the full plant, run from many postures over worker processes."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE
from systems.alpha_mixer import AlphaMixer
from systems.posture_history import PostureHistory
from systems.posture_regulator import make_posture_regulator

TIME_LIMIT = 10.0  # s: an arm that is not at home by then has failed
TICKS_AT_HOME = 5  # simulated beyond the arrival, for V
CHUNK = 25  # postures a job


class ReturnLoop:
    """The closed loop in mode `return` on the full plant (servo, effort limits, gravity, contact), without camera and network."""

    def __init__(self, world: World):
        self.world = world
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, camera=False))
        lower, upper, speed = controller_limits(self.station)
        size, period = ARM_JOINTS + 1, world.timing.period
        initial = world.initial_posture
        history = builder.AddNamedSystem(
            "posture_history", PostureHistory(posture_size=size, horizon=1, period=period, initial_posture=initial)
        )
        regulator = builder.AddSystem(
            make_posture_regulator(
                posture_size=size,
                joints=ARM_JOINTS,
                initial_posture=initial,
                Q=world.regulator.state_weight,
                R=world.regulator.input_weight,
                period=period,
            )
        )
        mixer = builder.AddNamedSystem(
            "alpha_mixer", AlphaMixer(posture_size=size, lower=lower, upper=upper, max_step=speed * period)
        )
        alpha = builder.AddNamedSystem("alpha", ConstantVectorSource(np.ones(1)))
        posture = history.GetOutputPort("posture")
        builder.Connect(self.station.GetOutputPort("posture"), history.GetInputPort("posture"))
        builder.Connect(posture, regulator.GetInputPort("posture"))
        for port in ("posture", "predicted_posture"):  # under alpha = 1 the prediction has no say
            builder.Connect(posture, mixer.GetInputPort(port))
        builder.Connect(regulator.GetOutputPort("step"), mixer.GetInputPort("regulator_step"))
        for port in ("alpha", "last_alphas"):
            builder.Connect(alpha.get_output_port(), mixer.GetInputPort(port))
        builder.Connect(mixer.GetOutputPort("desired_posture"), self.station.GetInputPort("desired_posture"))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)

    def run(
        self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, seconds: float = TIME_LIMIT
    ) -> tuple[np.ndarray, str | None]:
        """The way home from rest at `joints` (7, rad), until a little after the arrival, or for `seconds`.

        Returns:
            (n, 7) joint angles at the ticks, rad, and what Drake said where it broke off (a simulation that diverges), else None.
        """
        station, period = self.station, self.world.timing.period
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        station.set_scene(context, can_xy, vacant)
        station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(context), station.arm, joints)
        self.simulator.Initialize()
        local, port = station.GetMyContextFromRoot(context), station.GetOutputPort("posture")
        home = self.world.initial_posture[:ARM_JOINTS]
        rows, arrived = [np.array(joints, dtype=float)], 0
        for k in range(1, round(seconds / period) + 1):
            try:
                self.simulator.AdvanceTo(k * period)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                return np.array(rows), " ".join(str(error).split())
            rows.append(port.Eval(local)[:ARM_JOINTS].copy())
            arrived += bool(np.all(np.abs(rows[-1] - home) < HOME_TOLERANCE))
            if arrived > TICKS_AT_HOME:
                break
        return np.array(rows), None


@dataclass(frozen=True)
class Sample:
    """A posture at rest in a scene, from which the way home is run."""

    joints: np.ndarray  # (7,) rad
    can_xy: np.ndarray  # (2,) m, world
    vacant: str


@dataclass(frozen=True)
class Way:
    """What came of a sample: joint angles at the ticks (n, 7), rad; the model that the straight way home touches; why the simulation broke off."""

    rows: np.ndarray
    touches: str | None
    broke_off: str | None = None

    def arrival(self, home: np.ndarray) -> int:
        """First tick at which every joint is at `home` (7, rad); -1 without one, or where the simulation broke off."""
        there = np.all(np.abs(self.rows - home) < HOME_TOLERANCE, axis=1)
        return int(np.argmax(there)) if there.any() and self.broke_off is None else -1


class ReturnWorker:
    """The samples of one process: the diagram is built once."""

    def __init__(self, world: World):
        self.loop, self.clearance = ReturnLoop(world), CollisionChecker()

    def way(self, sample: Sample) -> Way:
        """Runs the sample."""
        self.clearance.set_scene(sample.can_xy, sample.vacant)
        touches = self.clearance.path_touches(sample.joints, self.loop.world.initial_posture[:ARM_JOINTS])
        rows, broke_off = self.loop.run(sample.joints, sample.can_xy, sample.vacant)
        return Way(rows, touches, broke_off)


_worker: ReturnWorker | None = None


def _run_chunk(world: World, chunk: list[Sample], path: Path) -> tuple[Path, list[Way]]:
    global _worker
    # With the first chunk, not by the pool's initializer, whose errors never reach the parent.
    _worker = _worker or ReturnWorker(world)
    ways = [_worker.way(sample) for sample in chunk]
    _save(path, ways)
    return path, ways


def ways_home(world: World, samples: list[Sample], workers: int, what: str, folder: Path) -> list[Way]:
    """The way of each sample, in their order, over so many processes.

    Args:
        what: title of the progress bar.
        folder: for the ways, a file of some samples each, as they come; what is there already is not run again.
    """
    from tqdm import tqdm

    folder.mkdir(parents=True, exist_ok=True)
    chunks = {_path(world, chunk, folder): chunk for chunk in batched(samples, CHUNK)}
    found = {path: ways for path, chunk in chunks.items() if (ways := _load(path, len(chunk))) is not None}
    missing = [(chunk, path) for path, chunk in chunks.items() if path not in found]
    with tqdm(
        total=len(samples), initial=sum(map(len, found.values())), desc=what, unit="posture", disable=None
    ) as bar:
        for path, ways in _run_chunks(world, missing, workers):
            found[path] = ways
            bar.update(len(ways))
    return [way for path in chunks for way in found[path]]


def _run_chunks(
    world: World, chunks: list[tuple[list[Sample], Path]], workers: int
) -> Iterator[tuple[Path, list[Way]]]:
    if workers == 1 or len(chunks) < 2:
        yield from (_run_chunk(world, *job) for job in chunks)
        return
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        for future in as_completed([pool.submit(_run_chunk, world, *job) for job in chunks]):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def batched(samples: list[Sample], size: int) -> list[list[Sample]]:
    """The samples in lists of `size`, the last one of what is left."""
    return [samples[i : i + size] for i in range(0, len(samples), size)]


def _path(world: World, chunk: list[Sample], folder: Path) -> Path:
    """Named after what decides the ways: the world and the samples."""
    digest = hashlib.sha256(repr(world).encode())
    for sample in chunk:
        digest.update(sample.joints.tobytes() + sample.can_xy.tobytes() + sample.vacant.encode())
    return folder / f"{digest.hexdigest()[:24]}.npz"


def _save(path: Path, ways: list[Way]) -> None:
    partial = path.with_name(f"{path.stem}.{os.getpid()}.part")
    words = json.dumps([[way.touches, way.broke_off] for way in ways])
    with partial.open("wb") as file:  # by name numpy would add .npz
        np.savez(file, allow_pickle=False, words=np.array(words), **{str(i): way.rows for i, way in enumerate(ways)})
    partial.replace(path)


def _load(path: Path, count: int) -> list[Way] | None:
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        words = json.loads(str(file["words"]))
        return [Way(file[str(i)], *words[i]) for i in range(count)]
