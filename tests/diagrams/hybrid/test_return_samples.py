"""Postures in the box, and those that the sampling of episodes draws."""

import numpy as np

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid import return_samples
from diagrams.hybrid.box_gauge import BoxGauge
from diagrams.hybrid.return_samples import Sample, box_samples, drawn_samples
from diagrams.world.collisions import CollisionChecker


def test_postures_of_the_box_touch_nothing(world):
    gauge, home = BoxGauge.of(world), world.initial_posture[:7]
    samples = box_samples(world, gauge, 12, np.random.default_rng(3))
    assert [sample.held for sample in samples] == [False, True] * 6
    checker = CollisionChecker(world, gap=0.0)
    for sample in samples:
        assert gauge.value(np.array(sample.joints) - home) <= 1.0
        checker.set_scene(None if sample.held else sample.can_xy, sample.vacant)
        assert checker.first_touch(np.array(sample.joints)) is None
    assert samples == box_samples(world, gauge, 12, np.random.default_rng(3))
    border = box_samples(world, gauge, 4, np.random.default_rng(3), border=True)
    assert np.allclose([gauge.value(np.array(s.joints) - home) for s in border], 1.0)


def test_draws_are_those_of_the_episodes_and_not_drawn_again(world, sampler, tmp_path, monkeypatch):
    seeds = [3_000_000, 3_000_001]

    def draw():
        with RowStore(tmp_path / "t.jsonl", fingerprint(world)) as store, Pool(0) as pool:
            return drawn_samples(world, seeds, pool, store, "draws")

    onsets, targets = draw()
    for seed, onset, target in zip(seeds, onsets, targets, strict=True):
        episode = sampler.sample(seed, "A")
        assert list(target.joints) == episode.disturbance.target
        assert np.array_equal(onset.joints, sampler.onset_posture(episode))
        assert onset.can_xy == target.can_xy == episode.can_xy
        assert onset.held == target.held == (episode.disturbance.subtask == 2)
    monkeypatch.setattr(return_samples, "run_draw", None)
    assert draw() == (onsets, targets)


def test_a_sample_survives_the_disk():
    sample = Sample((0.1,) * 7, (0.5, -0.01), "right", True)
    assert Sample.of({"joints": [0.1] * 7, "can_xy": [0.5, -0.01], "vacant": "right", "held": True}) == sample
    assert sample.key != Sample((0.1,) * 7, (0.5, -0.01), "right", False).key
