"""Sampling: what is random about an episode, within its bounds, from its seed alone."""

import numpy as np
import pytest

from diagrams.episodes.sampling import LIMIT_MARGIN, ONSET_LEVELS, SEED_BASE, STOP_TICKS, EpisodeSampler, episode_seeds
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import Grid, World
from diagrams.world.names import CAN_HALF_HEIGHT, SPOTS
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, subtask_commands
from models.errors import InputError


@pytest.fixture(scope="module")
def episodes(sampler):
    """A few of each kind."""
    return {kind: [sampler.sample(seed, kind) for seed in range(10)] for kind in ("none", "A", "B")}


def every(episodes):
    return [episode for kind in episodes.values() for episode in kind]


def test_unlearned_positions_are_one_to_two_centimetres_from_a_trained_one(sampler, world):
    lower, upper = world.grid.bounds
    rng = np.random.default_rng(0)
    sampled = np.array([sampler.unlearned_position(rng) for _ in range(300)])
    nearest = np.linalg.norm(sampled[:, None] - world.grid.training_positions(), axis=2).min(axis=1)
    assert np.all((nearest >= 0.010) & (nearest <= 0.020))
    assert np.all((sampled >= lower) & (sampled <= upper))
    # All over the area.
    assert np.all(np.ptp(sampled, axis=0) > 0.9 * (upper - lower))


@pytest.mark.parametrize("grid", [Grid(spacing=0.005), Grid(count=2)])
def test_a_grid_without_unlearned_positions_is_named(grid):
    with pytest.raises(InputError, match=r"no place of the trained area .* raise world\.grid\.spacing"):
        EpisodeSampler(World(grid=grid)).sample(0, "none")


def test_same_seed_same_episode(sampler, episodes):
    for kind, sampled in episodes.items():
        assert sampler.sample(3, kind) == sampled[3]


def test_seeds_differ(episodes):
    assert len({episode.can_xy for episode in episodes["none"]}) == 10
    assert {episode.vacant for episode in episodes["none"]} == set(SPOTS)


def test_scene_does_not_depend_on_the_disturbance(episodes):
    for none, a, b in zip(*episodes.values(), strict=True):
        assert (none.can_xy, none.vacant) == (a.can_xy, a.vacant) == (b.can_xy, b.vacant)


def test_bounds_of_the_disturbance(episodes):
    for episode in every(episodes):
        given = episode.disturbance
        if given.kind == "none":
            assert given.target is None
            continue
        low, high = ONSET_LEVELS[given.subtask]
        assert low <= given.level <= high
        if given.kind == "A":
            assert given.hold_ticks == 10
            assert given.can_moved_to is None
        else:
            assert STOP_TICKS[0] <= given.hold_ticks <= STOP_TICKS[1]
            assert given.target is None
            assert given.can_moved_to is None or given.subtask == 2
    sampled = [(e.disturbance.subtask, e.disturbance.can_moved_to is None) for e in episodes["B"]]
    assert set(sampled) == {(1, True), (2, True), (2, False)}


def posture_at_onset(world, hand, station, episode):
    """Where the teacher is when the approach distance falls below the level."""
    given = episode.disturbance
    centre = np.array([*episode.can_xy, CAN_HALF_HEIGHT]) if given.subtask == 1 else station.spot(episode.vacant)
    held = np.array([0, 0, GRASP_ABOVE_CENTRE if given.subtask == 2 else 0.0])
    rows = subtask_commands(world, hand, centre, given.subtask)
    distances = [np.linalg.norm(hand.grasp_position(row[:7]) - held - centre) for row in rows]
    return rows[np.argmax(np.array(distances) < given.level), :7]


def test_targets_are_off_the_path_and_within_limits(episodes, world, hand, station):
    checker, home = CollisionChecker(), world.initial_posture[:7]
    for episode in episodes["A"]:
        given = episode.disturbance
        target, start = np.array(given.target), posture_at_onset(world, hand, station, episode)
        assert hand.margin(target) >= LIMIT_MARGIN - 1e-9
        off = np.abs(np.rad2deg(target - start))
        moved = off[off > 1e-6]
        assert len(moved) >= 3
        assert np.all((moved >= 15.0 - 1e-6) & (moved <= 40.0 + 1e-6))
        checker.set_scene(episode.can_xy if given.subtask == 1 else None, episode.vacant)
        assert checker.path_touches(start, target) is None
        assert checker.path_touches(target, home) is None


def test_stopping_place_has_a_clear_path_home(episodes, world, hand, station):
    checker, home = CollisionChecker(), world.initial_posture[:7]
    for episode in episodes["B"]:
        checker.set_scene(episode.can_xy if episode.disturbance.subtask == 1 else None, episode.vacant)
        assert checker.path_touches(posture_at_onset(world, hand, station, episode), home) is None


@pytest.mark.parametrize("kind", ["none", "A", "B"])
def test_another_can_or_spot_leaves_the_other_samples(sampler, episodes, kind):
    for seed, sampled in enumerate(episodes[kind][:6]):
        other_spot = next(spot for spot in SPOTS if spot != sampled.vacant)
        placed = sampler.sample(seed, kind, can_xy=(0.5, 0.02))
        moved = sampler.sample(seed, kind, vacant=other_spot)
        assert (placed.can_xy, placed.vacant) == ((0.5, 0.02), sampled.vacant)
        assert (moved.can_xy, moved.vacant) == (sampled.can_xy, other_spot)
        for other in (placed, moved):
            assert other.disturbance.subtask == sampled.disturbance.subtask
            assert other.disturbance.hold_ticks == sampled.disturbance.hold_ticks
            assert other.disturbance.can_moved_to == sampled.disturbance.can_moved_to


@pytest.mark.parametrize("can", [(0.9, 0.0), (0.53, 0.3), (0.40, 0.0), (np.nan, 0.0), (np.inf, 0.0)])
def test_can_out_of_reach_is_refused(sampler, can):
    with pytest.raises(InputError, match=r"^the can"):
        sampler.sample(0, "none", can_xy=can)


def test_can_at_a_trained_position_is_welcome(sampler, world):
    for cell in ((0, 0), (9, 9), (0, 9), (9, 0)):
        xy = tuple(world.grid.position(*cell))
        assert sampler.sample(0, "none", can_xy=xy).can_xy == xy


def test_unknown_words_are_refused(sampler):
    with pytest.raises(InputError, match="no spot 'middle'"):
        sampler.sample(0, "none", vacant="middle")
    with pytest.raises(InputError, match="no disturbance 'C'"):
        sampler.sample(0, "C")


def test_validation_and_evaluation_never_share_a_seed():
    last = {purpose: episode_seeds(purpose, 99, 10_000)[-1] for purpose in SEED_BASE}
    assert SEED_BASE["validation"] <= last["validation"] < SEED_BASE["evaluation"] < last["evaluation"]
    assert episode_seeds("evaluation", 1, 2) == [2_010_000, 2_010_001]
    assert set(episode_seeds("validation", 0, 10_000)).isdisjoint(episode_seeds("validation", 1, 10_000))


@pytest.mark.parametrize(
    ("seed", "count", "named"), [(100, 1, "seed 100"), (-1, 1, "seed -1"), (0, 10_001, "10001 epi"), (0, 0, "0 epi")]
)
def test_seeds_beyond_their_purpose_are_refused(seed, count, named):
    with pytest.raises(InputError, match=named):
        episode_seeds("validation", seed, count)


def test_a_scene_that_leaves_no_path_home_is_named(sampler, world, monkeypatch):
    monkeypatch.setattr(CollisionChecker, "path_touches", lambda *_: "desk")
    with pytest.raises(InputError, match=r"no moment of subtask [12] with the can at .* clear path home: choose"):
        sampler.sample(0, "B")
    sampler.sample(0, "none")  # undisturbed, the arm has no path home to keep clear
    # Only paths home are clear.
    home = world.initial_posture[:7]
    monkeypatch.setattr(CollisionChecker, "path_touches", lambda _, a, b: None if np.array_equal(b, home) else "shelf")
    with pytest.raises(InputError, match=r"no posture 15 to 40 deg off .* give disturbance\.target"):
        sampler.sample(0, "A")


def test_long_paths_are_looked_at_every_degree(world, monkeypatch):
    checker, home = CollisionChecker(), world.initial_posture[:7]
    seen = []
    monkeypatch.setattr(checker, "first_touch", seen.append)
    assert checker.path_touches(home, home + np.deg2rad([0, 0, 0, 0, 0, 89.5, -10.0])) is None
    assert len(seen) == 91
    assert np.rad2deg(np.diff(seen, axis=0)[:, 5]) == pytest.approx(89.5 / 90)
    seen.clear()
    checker.path_touches(home, home + np.deg2rad(5.0))
    assert len(seen) == 24
