"""The table of a tick: what is slow is found where it is, every moment is counted once, and no bit changes."""

import cProfile
import pstats
import time

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.record import ARRAYS, record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.tick_table import PARTS, tick_table, tick_times
from tests.diagrams.closed_loop_fakes import FakeEncoder, FakePolicy

TICKS, ENCODING, NETWORK = 10, 0.03, 0.02  # s


class SlowEncoder(FakeEncoder):
    def encode(self, rgb):
        time.sleep(ENCODING)
        return super().encode(rgb)


class SlowPolicy(FakePolicy):
    def step(self, *given):
        time.sleep(NETWORK)
        return super().step(*given)


@pytest.fixture(scope="module")
def profiled(world):
    """The profile, the record under it, and one without."""
    policy = SlowPolicy(world)
    rollout, profiler = Rollout(world, SlowEncoder(), policy), cProfile.Profile()
    episode = Episode(0, (0.53, 0.0), "left")
    policy.learn(episode)
    with profiler:
        _, record = rollout.run(episode, time_limit=TICKS * world.timing.period)
    return profiler, record, rollout.run(episode, time_limit=TICKS * world.timing.period)[1]


def test_what_is_slow_is_found_where_it_is(profiled):
    times = tick_times(profiled[0], TICKS)
    assert tuple(times) == PARTS
    assert times["encoding"] >= ENCODING
    assert NETWORK <= times["network"] < times["encoding"]
    assert 0.0 < times["rest of the controller"] < times["network"]
    for part in ("rendering", "plant", "rest"):
        assert 0.0 < times[part] < times["encoding"]


def test_every_moment_is_counted_once(profiled):
    total = pstats.Stats(profiled[0]).total_tt
    assert sum(tick_times(profiled[0], TICKS).values()) == pytest.approx(total / TICKS)
    assert tick_table(profiled[0], TICKS).splitlines()[-1].split() == [
        "tick",
        f"{1e3 * total / TICKS:.2f}",
        "ms",
        "100%",
    ]


def test_the_run_is_the_same_to_the_bit(profiled):
    _, one, other = profiled
    for name in set(ARRAYS) - {"tick_seconds"}:
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert record_hash(one) == record_hash(other)
