"""The map from normal numbers to episodes: the distribution of the sampler."""

import numpy as np
import pytest
from scipy.stats import binom, ks_2samp, kstest, norm

from diagrams.episodes.sampling import DEFLECTED_JOINTS, DEFLECTION_DEG, STOP_TICKS
from diagrams.episodes.space import PLACES, TARGETS, EpisodeSpace, offset, whole
from models.errors import InputError

DRAWS = 200
ALIKE = 1e-3  # p-value of each comparison


@pytest.fixture(scope="module", params=["A", "B"])
def drawn(request, world, sampler):
    """Episodes of a kind by the map, and by the sampler."""
    space, rng = EpisodeSpace(world, request.param), np.random.default_rng(0)
    points = rng.standard_normal((DRAWS, space.size))
    return [space.episode(p) for p in points], [sampler.sample(s, request.param) for s in range(DRAWS)]


def numbers(episodes):
    """What is random about each, by name."""
    given = [e.disturbance for e in episodes]
    moved = [(g.can_moved_to or [np.nan, np.nan]) for g in given]
    found = {
        "x": [e.can_xy[0] for e in episodes], "y": [e.can_xy[1] for e in episodes],
        "moved x": [xy[0] for xy in moved], "moved y": [xy[1] for xy in moved], "hold": [g.hold_ticks for g in given],
    }  # fmt: skip
    for subtask in (1, 2):
        found[f"level {subtask}"] = [g.level for g in given if g.subtask == subtask]
        for joint in range(7 if given[0].target else 0):
            found[f"target {subtask} {joint}"] = [g.target[joint] for g in given if g.subtask == subtask]
    return {name: np.array(values)[np.isfinite(values)] for name, values in found.items()}


def test_the_map_has_the_distribution_of_the_sampler(drawn):
    mapped, sampled = (numbers(episodes) for episodes in drawn)
    assert all(episode is not None for episode in drawn[0])
    assert {name: len(v) > 20 for name, v in mapped.items()} == {name: len(v) > 20 for name, v in sampled.items()}
    for name, values in mapped.items():
        if len(values):
            assert ks_2samp(values, sampled[name]).pvalue > ALIKE, name


def test_choices_are_as_frequent_as_of_the_sampler(drawn):
    for what in (
        lambda e: e.disturbance.subtask == 2,
        lambda e: e.vacant == "left",
        lambda e: e.disturbance.can_moved_to is not None,
        lambda e: e.way_home_clear,
    ):
        mapped, sampled = (sum(map(what, episodes)) for episodes in drawn)
        share = (mapped + sampled) / (2 * DRAWS)
        assert abs(mapped - sampled) <= 4 * np.sqrt(2 * DRAWS * share * (1 - share)) + 1e-9


def test_same_point_same_episode_and_a_small_move_a_near_one(world):
    space = EpisodeSpace(world, "B")
    point = np.random.default_rng(1).standard_normal(space.size)
    first = space.episode(point)
    assert space.episode(point) == first
    for name, columns in space.blocks.items():
        moved = point.copy()
        moved[columns] = np.cos(1e-6) * point[columns] + np.sin(1e-6) * np.ones(len(columns))
        near = space.episode(moved)
        assert near.can_xy == pytest.approx(first.can_xy, abs=1e-5)
        assert (near.can_xy == first.can_xy) == (name != "scene")
        assert near.disturbance.level == pytest.approx(first.disturbance.level, abs=1e-5)
        assert (near.disturbance.level == first.disturbance.level) == (name != "moment")


def test_blocks_part_the_coordinates(world):
    for kind in ("A", "B"):
        space = EpisodeSpace(world, kind)
        assert np.array_equal(np.concatenate(list(space.blocks.values())), np.arange(space.size))


def test_an_offset_is_of_three_to_seven_joints_15_to_40_degrees():
    rng = np.random.default_rng(0)
    offsets = np.rad2deg([offset(rng.standard_normal(22)) for _ in range(4000)])
    counts = np.count_nonzero(offsets, axis=1)
    assert set(counts) == set(range(DEFLECTED_JOINTS[0], DEFLECTED_JOINTS[1] + 1))
    assert np.all(np.abs(np.bincount(counts)[3:] - 800) < 4 * binom.std(4000, 0.2))
    sizes = np.abs(offsets[offsets != 0.0])
    assert kstest((sizes - DEFLECTION_DEG[0]) / np.ptp(DEFLECTION_DEG), "uniform").pvalue > ALIKE
    assert np.mean(offsets > 0.0) == pytest.approx(np.mean(offsets < 0.0), abs=0.02)
    assert np.ptp(np.count_nonzero(offsets, axis=0)) < 250  # every joint as often as another


def test_whole_numbers_are_uniform_and_within_their_bounds():
    found = whole(STOP_TICKS, norm.ppf((np.arange(1100) + 0.5) / 1100))
    assert np.array_equal(np.bincount(found)[15:], [100] * 11)
    assert list(whole(STOP_TICKS, np.array([-40.0, 40.0]))) == [15, 25]


def test_where_no_candidate_will_do_there_is_no_episode(world, monkeypatch):
    space = EpisodeSpace(world, "A")
    asked = []
    monkeypatch.setattr(space._sampler, "comes_freely", lambda start, target: asked.append(target))
    point = np.random.default_rng(0).standard_normal(space.size)
    assert space.episode(point) is None
    assert len(asked) == TARGETS
    monkeypatch.setattr(space._sampler, "unlearned", lambda xy: False)
    assert space.episode(point) is None
    assert len(space.blocks["scene"]) == 2 * PLACES + 1


def test_undisturbed_episodes_have_no_space(world):
    with pytest.raises(InputError, match="choose A or B"):
        EpisodeSpace(world, "none")
