"""The switching point: its images, and the analysis of a network at it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from diagrams.hybrid.switching_point import SubtaskImage, analyse, subtask_images
from tests.diagrams.hybrid.hybrid_fakes import FEATURES, small_policy


def test_images_of_both_subtasks(world, encoder):
    first, second = subtask_images(world, encoder, (0.53, 0.0), "left")
    assert (first.subtask, second.subtask) == (1, 2)
    # The can is on the mat, then in the hand.
    assert (first.features[1], second.features[1]) == (1.0, 0.0)
    assert np.array_equal(first.posture, world.initial_posture)
    assert second.posture[-1] == world.closed_opening


def test_analysis_of_a_network(world, stored):
    image = SubtaskImage(1, FEATURES, world.initial_posture)
    found, norms = analyse(world, small_policy(stored, "mtrnn"), image, samples=3, seed=0)
    assert found["kind"] == "fixed point"
    assert found["residual"] < 1e-11
    assert found["jacobian_error"] < 1e-5
    assert found["decay_error"] < 0.1
    assert found["spectral_radius"] == pytest.approx(np.hypot(*found["eigenvalues"][0]))
    assert found["alpha"] == 1.0  # these heads recall nothing
    assert len(norms) == 3
    json.dumps(found, allow_nan=False)


def test_candidates_without_recall_heads_have_no_alpha(world, stored):
    candidate = replace(small_policy(stored, "mtrnn"), recall=None)
    found, _ = analyse(world, candidate, SubtaskImage(1, FEATURES, world.initial_posture), samples=1, seed=0)
    assert found["alpha"] is None
