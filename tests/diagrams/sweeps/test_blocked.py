"""Which scenes have a way home that is blocked: the first of their seed, whatever the number of workers."""

import pytest

from diagrams.episodes.sampling import episode_seeds
from diagrams.sweeps import blocked as blocked_module
from diagrams.sweeps.blocked import blocked_seeds, require_takes_arm
from models.errors import InputError

COUNT = 3


@pytest.fixture(scope="module")
def first(world):
    return blocked_seeds(world, "validation", 9, COUNT, "B", 0)


def test_they_are_the_first_of_their_seed(sampler, first):
    seeds = episode_seeds("validation", 9, 10_000)
    looked_at = seeds[: seeds.index(first[-1]) + 1]
    assert [seed for seed in looked_at if sampler.sample(seed, "B").way_home_clear is False] == first


def test_more_workers_find_the_same(world, first):
    assert blocked_seeds(world, "validation", 9, COUNT, "B", 2) == first


@pytest.mark.parametrize("kind", ["none", "moved"])
def test_a_kind_that_does_not_take_the_arm_is_refused(kind):
    with pytest.raises(InputError, match=f"'{kind}' there is no way home .* choose A or B"):
        require_takes_arm(["A", kind])


def test_more_than_there_are_is_refused(world, monkeypatch):
    monkeypatch.setattr(blocked_module, "SEEDS_APART", 40)
    with pytest.raises(InputError, match=r"of the 40 episodes of validation seed 9, \d+ have .* at most \d+ of them"):
        blocked_seeds(world, "validation", 9, 30, "B", 0)
