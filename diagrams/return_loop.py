"""The way home by itself: the closed loop in mode `return` on the full plant, run from many postures over worker processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from diagrams.clearance import Clearance
from diagrams.episode import HOME_TOLERANCE
from diagrams.rollout import controller_limits
from diagrams.scenario import World
from diagrams.station import ARM_JOINTS, PickPlaceStation
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

    def run(self, joints: np.ndarray, can_xy: np.ndarray, vacant: str, seconds: float = TIME_LIMIT) -> np.ndarray:
        """(n, 7) joint angles at the ticks, rad, from rest at `joints` (7, rad) until a little after the arrival, or for `seconds`."""
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
            self.simulator.AdvanceTo(k * period)
            rows.append(port.Eval(local)[:ARM_JOINTS].copy())
            arrived += bool(np.all(np.abs(rows[-1] - home) < HOME_TOLERANCE))
            if arrived > TICKS_AT_HOME:
                break
        return np.array(rows)


@dataclass(frozen=True)
class Sample:
    """A posture at rest in a scene, from which the way home is run."""

    joints: np.ndarray  # (7,) rad
    can_xy: np.ndarray  # (2,) m, world
    vacant: str


@dataclass(frozen=True)
class Way:
    """What came of a sample: joint angles at the ticks (n, 7), rad, and the model that the straight way home touches."""

    rows: np.ndarray
    touches: str | None


_loop: ReturnLoop | None = None
_clearance: Clearance | None = None


def _start(world: World) -> None:
    global _loop, _clearance
    _loop, _clearance = ReturnLoop(world), Clearance()


def _run_chunk(index: int, chunk: list[Sample]) -> tuple[int, list[Way]]:
    assert _loop is not None
    assert _clearance is not None
    ways = []
    for sample in chunk:
        _clearance.set_scene(sample.can_xy, sample.vacant)
        home = _loop.world.initial_posture[:ARM_JOINTS]
        touches = _clearance.straight_way_touches(sample.joints, home)
        ways.append(Way(_loop.run(sample.joints, sample.can_xy, sample.vacant), touches))
    return index, ways


def ways_home(world: World, samples: list[Sample], workers: int, what: str) -> list[Way]:
    """The way of each sample, in their order, over so many processes; `what`: title of the progress bar."""
    from tqdm import tqdm

    chunks = [samples[i : i + CHUNK] for i in range(0, len(samples), CHUNK)]
    found: dict[int, list[Way]] = {}
    with tqdm(total=len(samples), desc=what, unit="posture", disable=None) as bar:
        for index, ways in _run_chunks(world, chunks, workers):
            found[index] = ways
            bar.update(len(ways))
    return [way for index in range(len(chunks)) for way in found[index]]


def _run_chunks(world: World, chunks: list[list[Sample]], workers: int) -> Iterator[tuple[int, list[Way]]]:
    if workers == 1:
        _start(world)
        yield from (_run_chunk(index, chunk) for index, chunk in enumerate(chunks))
        return
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=_start, initargs=(world,)) as pool:
        for future in as_completed([pool.submit(_run_chunk, *job) for job in enumerate(chunks)]):
            yield future.result()
