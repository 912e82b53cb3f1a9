"""The guard surface: on a circle that is known, and on the closed loop with fakes."""

import json

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.hybrid.guard import GuardProbe, bisect, boundary_distance, contour, holds, report, save_guard, scan
from models.errors import InputError

PNG = b"\x89PNG\r\n\x1a\n"
DIRECTIONS = np.eye(7)[[0, 3]]


class Circle:
    """alpha is 1 beyond 7 deg; the arm cannot be displaced beyond 12 deg along joint 1."""

    def possible(self, displacement):
        return np.rad2deg(displacement[0]) < 12.0

    def __call__(self, displacement):
        size = np.rad2deg(np.linalg.norm(displacement))
        return float(size >= 7.0), (size / 7.0) ** 2


@pytest.fixture(scope="module")
def circle():
    return scan(Circle(), DIRECTIONS, 15.0, 31)


def test_grid_by_hand(circle):
    assert circle.resolution == pytest.approx(1.0)
    assert circle.alpha.shape == (31, 31)
    assert np.isnan(circle.alpha[:, 27:]).all()
    assert np.isfinite(circle.alpha[:, :27]).all()
    # Rows are the second coordinate.
    assert (circle.alpha[15, 15], circle.alpha[15, 23], circle.alpha[21, 15]) == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, 4.0])
def test_bisection_finds_the_circle(circle, angle):
    point = bisect(Circle(), DIRECTIONS, 15.0, angle)
    assert point == pytest.approx(7.0 * np.array([np.cos(angle), np.sin(angle)]), abs=1e-4)
    assert boundary_distance(contour(circle, 1.0), point) < 0.05 * circle.resolution


def test_ray_that_stays_in_the_task_has_no_point():
    assert bisect(Circle(), DIRECTIONS, 4.0, 0.0) is None


def test_distance_to_the_boundary_by_hand(circle):
    lines = contour(circle, 1.0)
    assert boundary_distance(lines, np.array([7.0, 0.0])) == pytest.approx(0.0, abs=1e-6)
    assert boundary_distance(lines, np.array([9.0, 0.0])) == pytest.approx(2.0, abs=0.02)
    assert boundary_distance([np.array([[0.0, 0.0], [4.0, 0.0]])], np.array([1.0, 3.0])) == 3.0
    assert boundary_distance(contour(scan(Circle(), DIRECTIONS, 3.0, 5), 1.0), np.zeros(2)) == np.inf


def test_report_agrees_within_the_resolution(circle, tmp_path):
    points = [bisect(Circle(), DIRECTIONS, 15.0, a) for a in np.linspace(0, 6, 12)]
    found = report(circle, points, 1.0)
    assert holds(found)
    assert found["bisection_error"] <= found["resolution"] == pytest.approx(1.0)
    assert found["smallest_detected_deg"] == pytest.approx(7.0, abs=1e-3)
    assert found["impossible"] == 31 * 4
    json.dumps(found, allow_nan=False)
    save_guard(circle, points, ("a", "b"), 1.0, "title", tmp_path / "guard.png")
    assert (tmp_path / "guard.png").read_bytes().startswith(PNG)
    assert not holds(report(circle, [np.array([10.0, 0.0])], 1.0))
    assert not holds(report(circle, [], 1.0))


@pytest.fixture(scope="module")
def probe(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    return GuardProbe(rollout, episode, 0.25, 2)


def test_displacement_is_noticed_in_the_closed_loop(probe):
    nothing, _ = probe(np.zeros(7))
    assert nothing < 1e-6
    far = np.deg2rad([15.0, 0, 0, 0, 0, 0, 0])
    assert probe.possible(far)
    assert probe(far)[0] > 0.99


def test_the_controller_samples_the_arm_where_it_was_put(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    probe = GuardProbe(rollout, episode, 0.25, 1)
    displacement = np.deg2rad([12.0, -3.0, 0.0, 8.0, 0.0, 5.0, -9.0])
    probe(displacement)
    controller = rollout.controller
    history = controller.GetOutputPort("posture_history").Eval(
        controller.GetMyContextFromRoot(rollout.simulator.get_context())
    )
    assert policy.scaling.unscale(history[:8])[:7] == pytest.approx(probe.joints + displacement, abs=1e-9)


def test_the_same_displacement_gives_the_same_bits(probe):
    displacement = np.deg2rad([0.4, 0, 0, 0.3, 0, 0, 0])
    first = probe(displacement)
    probe(np.deg2rad([5.0, 0, 0, 0, 0, 0, 0]))
    assert probe(displacement) == first


def test_the_arm_is_not_put_through_limits_or_desk(probe):
    assert probe.possible(np.zeros(7))
    assert not probe.possible(np.deg2rad([0, 0, 0, 60.0, 0, 0, 0]))
    assert not probe.possible(np.deg2rad([0, 30.0, 0, 0, 0, 0, 0]))


def test_a_moment_that_never_comes(rollout, policy):
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    with pytest.raises(InputError, match="does not come within"):
        GuardProbe(rollout, episode, 1e-4, 2)
