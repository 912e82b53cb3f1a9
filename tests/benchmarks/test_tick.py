"""What the closed loop costs over its own bare station, and what its parts cost: limits that hold on any machine."""

import time
from collections import OrderedDict

import numpy as np
import pytest
import torch
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from diagrams.episodes.calibration import Controller, policy_file, stored_calibration
from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.runner import build_rollout
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.world.clearance_map import clearance_filter
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.station import PickPlaceStation, add_models
from diagrams.world.task import TIME_LIMIT
from models.command_line import ROOT
from models.inference import Encoder
from models.networks.cae import ConvolutionalAutoencoder, to_image
from tests.diagrams.closed_loop_fakes import FakeEncoder, FakePolicy


@pytest.fixture(scope="module")
def loop(world):
    """The shipped controller in its world, and its calibration."""
    rollout = build_rollout(world, WEIGHTS / ENCODER, Controller(policy_file(WEIGHTS, "lstm")))
    return rollout, stored_calibration("recall", rollout.policy, WEIGHTS)


class TickTimer:
    """`on_tick` of a Rollout: the time of each tick but the first, s, without what `between(tick)` takes."""

    def __init__(self, between=None):
        self.times, self._between, self._last = [], between, None

    def __call__(self, tick):
        now = time.perf_counter()
        if self._last is not None:
            self.times.append(now - self._last)
        if self._between is not None:
            self._between(tick)
        self._last = time.perf_counter()


class BareStation:
    """A station that is led along a path: the plant, and one rendering a tick where it has a camera that is read."""

    def __init__(self, world, camera=True, read=True):
        self._station, self._period = PickPlaceStation(world, camera=camera), world.timing.period
        self._simulator = Simulator(self._station)
        self._desired = self._station.GetInputPort("desired_posture")
        self._picture = self._station.GetOutputPort("rgb_image") if camera and read else None

    def run(self, episode, path):
        """Seconds a tick, along the postures `path` (ticks, 8)."""
        self._simulator.reset_context(self._station.CreateDefaultContext())
        context = self._simulator.get_mutable_context()
        self._station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        self._desired.FixValue(context, path[0])
        self._simulator.Initialize()
        timer = TickTimer()
        for k, posture in enumerate(path):
            self._simulator.AdvanceTo(k * self._period)
            if self._picture is not None:
                self._picture.Eval(context)
            self._desired.FixValue(context, posture)
            timer(k)
        return np.mean(timer.times)


@pytest.mark.parametrize(("kind", "limit"), [("none", 1.70), ("A", 1.55)])
def test_closed_loop_over_its_bare_station(loop, world, measure, in_turns, hold, kind, limit):
    """A whole episode, in A with the ticks at which the network is not listened to."""
    (rollout, calibration), bare = loop, BareStation(world)
    episode, seconds = EpisodeSampler(world).sample(0, kind), TIME_LIMIT if measure else 1.0

    def closed():
        timer = TickTimer()
        _, record = rollout.run(episode, on_tick=timer, time_limit=seconds, calibration=calibration)
        closed.path = record.posture[1:]  # what the arm did, whoever moved it
        return np.mean(timer.times)

    (ratio,) = in_turns(closed, lambda: bare.run(episode, closed.path))
    hold(f"closed loop over its bare station, disturbance {kind}", ratio, at_most=limit)


def test_ninety_nine_in_a_hundred_ticks_are_soon_done(loop, world, measure, hold):
    """Of whole episodes, as their records have them: scoring is in it, the start of a process is not."""
    (rollout, calibration), sampler = loop, EpisodeSampler(world)
    seconds = TIME_LIMIT if measure else 1.0
    rollout.run(sampler.sample(0, "none"), time_limit=1.0, calibration=calibration)
    records = [
        rollout.run(sampler.sample(seed, kind), time_limit=seconds, calibration=calibration)[1]
        for seed in range(3 if measure else 1)
        for kind in ("none", "A", "B")
    ]
    ticks = np.concatenate([record.tick_seconds for record in records])
    assert len(ticks) == sum(len(record.time) for record in records)
    hold("99 % of the ticks, ms", 1e3 * np.quantile(ticks, 0.99), at_most=50.0)


def test_what_the_monitor_of_the_requirements_costs(loop, world, measure, in_turns, hold):
    (rollout, calibration), episode = loop, EpisodeSampler(world).sample(0, "A")
    monitored = build_rollout(world, WEIGHTS / ENCODER, Controller(policy_file(WEIGHTS, "lstm")), monitored=True)

    def seconds(of):
        timer = TickTimer()
        of.run(episode, on_tick=timer, time_limit=TIME_LIMIT if measure else 1.0, calibration=calibration)
        return np.mean(timer.times)

    (ratio,) = in_turns(lambda: seconds(monitored), lambda: seconds(rollout))
    hold("closed loop with the monitor over without", ratio, at_most=1.1)


def test_a_camera_that_is_not_read_costs_the_physics_nothing(world, in_turns, hold):
    """A renderer in the plant's own scene graph would double the time of every step."""
    episode, path = Episode(0, (0.53, 0.0), "left"), np.tile(world.initial_posture, (100, 1))
    unread, without = BareStation(world, read=False), BareStation(world, camera=False)
    (ratio,) = in_turns(lambda: unread.run(episode, path), lambda: without.run(episode, path))
    hold("physics with a camera that is not read over physics alone", ratio, at_most=1.2)


def test_filter_over_the_rendering_that_the_way_home_spares(world, measure, in_turns, hold):
    """On the way home from the shelf with a can in the hand, round the can that may stand on the other spot."""
    station = PickPlaceStation(world)
    context, system = station.CreateDefaultContext(), clearance_filter(world, station)
    own, home = system.CreateDefaultContext(), world.initial_posture[:7]
    hand = HandKinematics(world)
    start = np.append(hand.solve_ik(station.spot("left") + [0, 0, 0.06]), world.closed_opening)
    system.GetInputPort("alpha").FixValue(own, [1.0])

    def filtered():
        posture, times = start, []
        for _ in range(30 if measure else 3):
            step = np.append(0.1 * (home - posture[:7]), 0.0)
            begin = time.perf_counter()
            system.GetInputPort("posture").FixValue(own, posture)
            system.GetInputPort("desired_posture").FixValue(own, posture + step)
            posture = system.GetOutputPort("filtered_posture").Eval(own)
            times.append(time.perf_counter() - begin)
        return np.mean(times)

    def rendered():
        times = []
        for turn in np.linspace(-0.3, 0.3, 30 if measure else 2):
            station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(context), station.arm, home + turn)
            begin = time.perf_counter()
            station.GetOutputPort("rgb_image").Eval(context)
            times.append(time.perf_counter() - begin)
        return np.mean(times)

    (ratio,) = in_turns(filtered, rendered)
    hold("a filtered step of the way home over a rendering", ratio, at_most=0.5)


def fused_encoder():
    """The encoder of Table I as torch alone makes it fast: batch norms fused in, channels last, dense layers."""
    layers = ConvolutionalAutoencoder().eval().encoder
    with torch.no_grad():
        fused = [
            *((f"{n}", nn.Sequential(fuse_conv_bn_eval(getattr(layers, n), getattr(layers, f"{n}_norm")), nn.ReLU()))
              for n in ("conv0", "conv1", "conv2")),
            ("flatten", nn.Flatten()),
            ("full", nn.Sequential(fuse_linear_bn_eval(layers.full, layers.full_norm), nn.ReLU())),
            ("feature", nn.Sequential(fuse_linear_bn_eval(layers.feature, layers.feature_norm), nn.Tanh())),
        ]  # fmt: skip
    return nn.Sequential(OrderedDict(fused)).to(memory_format=torch.channels_last)


def test_encoder_over_torch(world, measure, in_turns, hold):
    """On pictures of a run, each after 16 MB of other memory, as the physics leaves it between two ticks."""
    station, others = PickPlaceStation(world), np.zeros(2 << 20)
    context = station.CreateDefaultContext()
    pictures = []
    for turn in np.linspace(-0.3, 0.3, 30 if measure else 2):
        joints = world.initial_posture[:7] + [turn, 0.5 * turn, 0, 0, 0, 0, 0]
        station.plant.SetPositions(station.plant.GetMyMutableContextFromRoot(context), station.arm, joints)
        pictures.append(station.GetOutputPort("rgb_image").Eval(context).data[:, :, :3].copy())
    encoder, fused = Encoder(WEIGHTS / ENCODER), fused_encoder()

    def by_torch(picture):
        with torch.inference_mode():
            return fused(to_image(torch.from_numpy(picture)[None]))[0].double().numpy()

    def seconds(encode):
        times = []
        for picture in pictures:
            np.add(others, 1.0, out=others)
            start = time.perf_counter()
            encode(picture)
            times.append(time.perf_counter() - start)
        return np.median(times)

    (ratio,) = in_turns(lambda: seconds(encoder.encode), lambda: seconds(by_torch))
    hold("encoder over torch's fused one", ratio, at_most=0.45)


class BlindEncoder(FakeEncoder):
    """Sees no can, so that the fake network waits for ever."""

    def encode(self, rgb):
        return 0.0 * super().encode(rgb)


def test_a_tick_costs_the_same_after_10000(world, measure, hold):
    """Late ticks of one run against early ticks of others that are run in between."""
    episode, policy = Episode(0, (0.53, 0.0), "left"), FakePolicy(world)
    long, short = (Rollout(world, BlindEncoder(), policy) for _ in range(2))
    count, block, blocks = (10_000, 100, 9) if measure else (40, 5, 2)
    early = []

    def run_short(tick):
        if tick >= count - blocks * block and tick % block == 0:
            timer = TickTimer()
            short.run(episode, on_tick=timer, time_limit=2 * block * world.timing.period)
            early.append(np.median(timer.times[block:]))

    timer = TickTimer(run_short)
    long.run(episode, on_tick=timer, time_limit=count * world.timing.period)
    late = np.median(np.reshape(timer.times[-blocks * block :], (blocks, block)), axis=1)
    assert len(timer.times) == count - 1
    hold("tick 9,100 to 10,000 over tick 100 to 200", np.median(late / early[:blocks]), at_most=1.05)


def test_models_over_one_file_each(world, in_turns, hold):
    """Why diagrams/world/station.py includes the models in a string."""

    def seconds(add):
        plant = MultibodyPlant(0.0)
        start = time.perf_counter()
        add(plant)
        return time.perf_counter() - start

    def by_files(plant):
        parser = Parser(plant)
        parser.package_map().AddPackageXml(str(ROOT / "sdf" / "package.xml"))
        ProcessModelDirectives(LoadModelDirectives(str(ROOT / "sdf" / "pick_place.dmd.yaml")), parser)

    (ratio,) = in_turns(lambda: seconds(lambda plant: add_models(plant, world)), lambda: seconds(by_files))
    hold("reading the models over ProcessModelDirectives", ratio, at_most=0.25)
