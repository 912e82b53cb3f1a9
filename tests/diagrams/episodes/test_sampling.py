"""Sampling: what is random about an episode, within its bounds, from its seed alone."""

import numpy as np
import pytest

from diagrams.episodes.sampling import (
    LIVE_DRAWS,
    MOVED_BY,
    ONSET_LEVELS,
    SEED_BASE,
    STOP_TICKS,
    EpisodeSampler,
    episode_seeds,
)
from diagrams.world.collisions import CollisionChecker
from diagrams.world.configuration import Grid, World
from diagrams.world.names import CAN_HALF_HEIGHT, DISTURBANCES, LIMIT_MARGIN, MOVED, SPOTS
from diagrams.world.trajectory import GRASP_ABOVE_CENTRE, subtask_commands
from models.errors import InputError


@pytest.fixture(scope="module")
def episodes(sampler):
    """A few of each kind."""
    return {kind: [sampler.sample(seed, kind) for seed in range(12)] for kind in (*DISTURBANCES, MOVED)}


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


def test_a_grid_beyond_the_arm_is_named():
    with pytest.raises(InputError, match="cannot reach") as refused:
        EpisodeSampler(World(grid=Grid(spacing=0.5))).sample(0, "none")
    assert "world.grid (Grid(corner=[0.44, -0.09], spacing=0.5, count=10)): lower" in refused.value.__notes__[0]


def test_same_seed_same_episode(sampler, episodes):
    for kind, sampled in episodes.items():
        assert sampler.sample(3, kind) == sampled[3]


def test_seeds_differ(episodes):
    assert len({episode.can_xy for episode in episodes["none"]}) == 12
    assert {episode.vacant for episode in episodes["none"]} == set(SPOTS)


def test_scene_does_not_depend_on_the_disturbance(episodes):
    for same in zip(*episodes.values(), strict=True):
        assert len({(episode.can_xy, episode.vacant) for episode in same}) == 1


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
        elif given.kind == "B":
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


def test_a_moved_can_stays_in_reach_of_what_was_taught(sampler, episodes):
    for episode in episodes[MOVED]:
        given = episode.disturbance
        given.check()
        assert (given.subtask, given.takes_arm, given.can_tick, episode.way_home_clear) == (1, False, 0, None)
        sampler.require_reachable(given.can_moved_to)
        assert MOVED_BY[0] <= np.hypot(*np.subtract(given.can_moved_to, episode.can_xy)) <= MOVED_BY[1]
    moves = np.array([np.subtract(e.disturbance.can_moved_to, e.can_xy) for e in episodes[MOVED]])
    assert (moves.min(axis=0) < -0.01).all()  # in all directions
    assert (moves.max(axis=0) > 0.01).all()


def way_home_touches(checker, world, episode, left_at):
    """What the straight way home touches, the fingers as wide open as they are then."""
    given = episode.disturbance
    if given.can_moved_to is not None:  # closed, the can elsewhere
        checker.set_scene(given.can_moved_to, episode.vacant, 0.03)
    else:
        checker.set_scene(episode.can_xy if given.subtask == 1 else None, episode.vacant, 0.08)
    return checker.path_touches(left_at, world.initial_posture[:7])


def test_targets_are_off_the_path_and_within_limits(episodes, world, hand, station):
    checker = CollisionChecker(world)
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
        assert episode.way_home_clear == (way_home_touches(checker, world, episode, target) is None)


def test_a_way_home_that_touches_something_is_kept_and_said(sampler, world, hand, station):
    checker, clear = CollisionChecker(world), []
    for seed in range(40):
        episode = sampler.sample(seed, "B")
        touched = way_home_touches(checker, world, episode, posture_at_onset(world, hand, station, episode))
        assert episode.way_home_clear == (touched is None)
        clear.append(episode.way_home_clear)
    assert 0.5 < np.mean(clear) < 1.0  # some of both


def test_no_way_home_is_a_reason_to_draw_again(sampler, world, monkeypatch):
    drawn = [sampler.sample(seed, kind) for kind in "AB" for seed in range(4)]
    home, touches = world.initial_posture[:7], CollisionChecker.path_touches
    monkeypatch.setattr(
        CollisionChecker, "path_touches", lambda self, a, b: "desk" if np.array_equal(b, home) else touches(self, a, b)
    )
    blocked = [sampler.sample(seed, kind) for kind in "AB" for seed in range(4)]
    assert [episode.disturbance for episode in blocked] == [episode.disturbance for episode in drawn]
    assert not any(episode.way_home_clear for episode in blocked)


@pytest.mark.parametrize("kind", DISTURBANCES)
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


def test_a_scene_that_leaves_no_way_to_a_posture_is_named(sampler, monkeypatch):
    monkeypatch.setattr(CollisionChecker, "path_touches", lambda *_: "shelf")
    with pytest.raises(InputError, match=r"no posture 15 to 40 deg off .* give disturbance\.target"):
        sampler.sample(0, "A")
    sampler.sample(0, "B")  # stopped where it is


def test_an_arm_is_pushed_away_among_the_cans_as_they_stand(sampler, hand, world, monkeypatch):
    """A can at a finger is named at once; one in the hand comes along; one that was lifted is not on the desk."""
    rng, opening = np.random.default_rng(0), world.opening
    xy, upright = (0.5, 0.0), [1.0, 0.0, 0.0, 0.0]
    joints = hand.solve_ik(np.array([*xy, 0.25]))
    neighbour = [*upright, 0.3, -0.4, 0.05]
    there = np.array([*upright, *hand.grasp_position(joints) - [0.0, 0.0, 0.01], *neighbour])
    below = np.array([*upright, *xy, 0.05, *neighbour])
    beside = there + np.array([0, 0, 0, 0, 0, 0.03, 0] + [0] * 7)
    with pytest.raises(InputError, match="so near to the can to pick that it cannot be moved away: wait"):
        sampler.pushed_away(rng, np.append(joints, opening), beside)
    for opened, poses in ((world.closed_opening, there), (opening, below)):
        target = sampler.pushed_away(rng, np.append(joints, opened), poses)
        assert np.rad2deg(np.abs(target - joints)).max() > 14.9
    seen = []
    monkeypatch.setattr(CollisionChecker, "path_touches", lambda *_: seen.append(1) or "shelf")
    with pytest.raises(InputError, match=r"no posture was found near by .* wait, or put the can elsewhere"):
        sampler.pushed_away(rng, np.append(joints, opening), below)
    assert len(seen) <= LIVE_DRAWS


def test_long_paths_are_looked_at_every_degree(world, monkeypatch):
    checker, home = CollisionChecker(world), world.initial_posture[:7]
    seen = []
    monkeypatch.setattr(checker, "first_touch", seen.append)
    assert checker.path_touches(home, home + np.deg2rad([0, 0, 0, 0, 0, 89.5, -10.0])) is None
    assert len(seen) == 91
    assert np.rad2deg(np.diff(seen, axis=0)[:, 5]) == pytest.approx(89.5 / 90)
    seen.clear()
    checker.path_touches(home, home + np.deg2rad(5.0))
    assert len(seen) == 24


def test_the_onset_is_on_the_teachers_way(sampler, world, hand):
    for seed in range(4):
        episode = sampler.sample(seed, "A")
        given, joints = episode.disturbance, sampler.onset_posture(episode)
        offset = np.abs(np.array(given.target) - joints)
        assert np.sum(offset > np.deg2rad(14.9)) == np.sum(offset > 1e-9)  # from there the arm is deflected
        if given.subtask == 1:
            goal = [*episode.can_xy, CAN_HALF_HEIGHT]
            assert np.linalg.norm(hand.grasp_position(joints) - goal) == pytest.approx(given.level, abs=0.02)
