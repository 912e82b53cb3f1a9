import numpy as np
import pytest

from models.data.scaling import MinMaxScaling


def test_maps_bounds_to_one_and_back() -> None:
    scaling = MinMaxScaling(np.array([-1.0, 0.0]), np.array([3.0, 0.08]))
    np.testing.assert_allclose(
        scaling.scale(np.array([[-1.0, 0.0], [3.0, 0.08], [1.0, 0.04]])), [[-1, -1], [1, 1], [0, 0]], atol=1e-12
    )
    x = np.random.default_rng(0).normal(size=(5, 2))
    np.testing.assert_allclose(scaling.unscale(scaling.scale(x)), x)


def test_from_data_widens_by_the_margin_and_keeps_a_least_range() -> None:
    scaling = MinMaxScaling.from_data(np.array([[0.0, 5.0], [2.0, 5.0]]), margin=1.1, minimum_half_range=0.01)
    np.testing.assert_allclose(scaling.lower, [-0.1, 4.99])
    np.testing.assert_allclose(scaling.upper, [2.1, 5.01])


def test_rejects_bounds_the_wrong_way_round() -> None:
    with pytest.raises(ValueError, match="lower < upper"):
        MinMaxScaling(np.array([1.0]), np.array([0.0]))
