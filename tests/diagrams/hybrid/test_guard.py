"""The guard surface, on a circle that is known."""

import json

import numpy as np
import pytest

from diagrams.hybrid.guard import bisect, boundary_distance, contour, holds, report, scan

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


def test_report_agrees_within_the_resolution(circle):
    points = [bisect(Circle(), DIRECTIONS, 15.0, a) for a in np.linspace(0, 6, 12)]
    found = report(circle, points, 1.0)
    assert holds(found)
    assert found["bisection_error"] <= found["resolution"] == pytest.approx(1.0)
    assert found["smallest_detected_deg"] == pytest.approx(7.0, abs=1e-3)
    assert found["impossible"] == 31 * 4
    json.dumps(found)
    assert not holds(report(circle, [np.array([10.0, 0.0])], 1.0))
    assert not holds(report(circle, [], 1.0))
