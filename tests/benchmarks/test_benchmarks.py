"""Where the time of a tick goes. Times are recorded; only ratios within one run are asserted, never seconds.

pytest tests/benchmarks --benchmark-enable
"""

import time

import numpy as np
import pytest
import torch
from pydrake.systems.analysis import Simulator

from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import World
from diagrams.world.station import PickPlaceStation
from models.files.weights import load_autoencoder
from models.networks.cae import to_image

ROUNDS = 50


class Ticks:
    """Advances a station, alone or in a closed loop, by one tick a call."""

    def __init__(self, station, simulator, context):
        self._simulator, self._period, self._tick = simulator, station.world.timing.period, 0
        if context is not None:
            station.GetInputPort("desired_posture").FixValue(context, station.world.initial_posture)
        simulator.AdvanceTo(0.05)  # not the first rendering

    def __call__(self):
        self._tick += 1
        self._simulator.AdvanceTo((self._tick + 0.5) * self._period)


def bare_physics(camera):
    station = PickPlaceStation(World(), camera=camera)
    simulator = Simulator(station)
    return Ticks(station, simulator, simulator.get_mutable_context())


@pytest.fixture
def closed_loop(encoder, policy):
    rollout = Rollout(World(), encoder, policy)
    rollout.prepare(Episode(0, (0.53, 0.0), "left"))
    return Ticks(rollout.station, rollout.simulator, None)


def measure(benchmark, function):
    benchmark.pedantic(function, rounds=ROUNDS, warmup_rounds=2)
    if benchmark.enabled:
        benchmark.extra_info["times real time at 0.1 s"] = round(0.1 / benchmark.stats.stats.median, 1)


@pytest.mark.benchmark(group="tick")
def test_tick_of_the_closed_loop(benchmark, closed_loop):
    measure(benchmark, closed_loop)


@pytest.mark.benchmark(group="tick")
def test_tick_of_the_physics(benchmark):
    measure(benchmark, bare_physics(camera=False))


@pytest.mark.benchmark(group="tick")
def test_rendering(benchmark):
    station = PickPlaceStation(World())
    context = station.CreateDefaultContext()
    plant_context = station.plant.GetMyMutableContextFromRoot(context)
    joints = station.world.initial_posture[:7].copy()

    def render():
        joints[0] += 1e-3  # else the picture is still in the cache
        station.plant.SetPositions(plant_context, station.arm, joints)
        return station.GetOutputPort("rgb_image").Eval(context)

    measure(benchmark, render)


@pytest.fixture(scope="module")
def image():
    return np.random.default_rng(0).integers(0, 256, (112, 112, 3), np.uint8)


@pytest.fixture(scope="module")
def plain_encoder(weights, image):
    """The same function as Encoder.encode, as the torch module has it."""
    model, _ = load_autoencoder(weights / "encoder.onnx")
    model.to(memory_format=torch.channels_last)

    def encode():
        with torch.inference_mode():
            return model.encode(to_image(torch.from_numpy(image[None])))[0].double().numpy()

    return encode


@pytest.mark.benchmark(group="encoder")
def test_encoder(benchmark, encoder, image):
    measure(benchmark, lambda: encoder.encode(image))


@pytest.mark.benchmark(group="encoder")
def test_plain_encoder(benchmark, plain_encoder):
    measure(benchmark, plain_encoder)


@pytest.mark.benchmark(group="network")
def test_network_step_and_recall(benchmark, policy):
    x, state = np.zeros(policy.posture_size + policy.feature_size), policy.initial_state

    def step():
        return policy.recall(policy.step(x, state)[1])

    measure(benchmark, step)


@pytest.fixture
def measuring(request):
    """Skips where nothing is measured: a ratio means something on a machine on which nothing else runs."""
    if request.config.getoption("benchmark_disable") and not request.config.getoption("benchmark_enable"):
        pytest.skip("a ratio of times: --benchmark-enable")


def best_times(*functions, rounds):
    """The shortest time of each, s, taken in turns: what else runs on this machine slows all of them alike."""
    times = np.empty((rounds, len(functions)))
    for row in times:
        for i, function in enumerate(functions):
            start = time.perf_counter()
            function()
            row[i] = time.perf_counter() - start
    return times.min(axis=0)


def test_encoder_is_faster_than_the_plain_module(measuring, encoder, plain_encoder, image):
    fast, plain = best_times(lambda: encoder.encode(image), plain_encoder, rounds=30)
    assert fast < plain


def test_camera_that_is_not_read_costs_the_physics_nothing(measuring):
    """A renderer in the plant's own scene graph would double the time of every step."""
    without, unread = best_times(bare_physics(camera=False), bare_physics(camera=True), rounds=40)
    assert unread < 1.5 * without


def test_controller_takes_less_than_ten_times_the_physics(measuring, closed_loop):
    physics, whole = best_times(bare_physics(camera=False), closed_loop, rounds=60)
    assert whole < 10 * physics
