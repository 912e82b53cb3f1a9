"""Fixtures: one station, one kinematics, one closed loop with fakes a process."""

import pytest

from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.station import PickPlaceStation
from tests.diagrams.closed_loop_fakes import FakeEncoder, FakePolicy


@pytest.fixture(scope="session")
def world():
    return World()


@pytest.fixture(scope="session")
def station(world):
    return PickPlaceStation(world)


@pytest.fixture(scope="session")
def hand(world):
    return HandKinematics(world)


@pytest.fixture(scope="session")
def sampler(world):
    return EpisodeSampler(world)


@pytest.fixture(scope="session")
def encoder():
    return FakeEncoder()


@pytest.fixture(scope="session")
def policy(world):
    return FakePolicy(world)


@pytest.fixture(scope="session")
def rollout(world, encoder, policy):
    """The whole closed loop without weights."""
    return Rollout(world, encoder, policy, monitored=True)
