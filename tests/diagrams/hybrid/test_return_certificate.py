"""The certificate of mode return: a small proof on the plant."""

import json

import numpy as np
import pytest

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid import return_certificate
from diagrams.hybrid.return_certificate import certify, holds
from diagrams.hybrid.return_trajectories import Trajectory
from diagrams.world.station import controller_limits
from models.errors import InputError

UNITS = np.array([0.7, 0.5, 0.3, 0.7, 0.3, 0.5, 0.3])


def make(world, folder):
    with RowStore(folder / "t.jsonl", fingerprint(world)) as store, Pool(0) as pool:
        return certify(world, UNITS, samples=12, outside=4, seed=0, pool=pool, store=store)


@pytest.fixture(scope="module")
def certificate(world, tmp_path_factory):
    return make(world, tmp_path_factory.mktemp("certificate"))


def test_certificate_is_borne_out(certificate):
    found, picture = certificate
    assert holds(found)
    assert (found["samples_inside"], found["samples_outside"]) == (12, 4)
    assert (found["failures_inside"], found["later_than_certified"]) == (0, 0)
    assert 0.81 < found["contraction_rate"] < 1.0
    assert found["contraction_rate_measured"] <= found["contraction_rate"]
    assert found["max_v_increase"] <= found["v_tolerance"]
    assert found["level"] == min(found["levels"].values())
    assert found["collision_share"]["any"] == sum(name is not None for name in picture["inside"]["touches"]) / 12
    assert all(v[0] <= found["level"] for v in picture["values"])
    json.dumps(found)


def test_set_is_within_the_limits(certificate, world, station):
    found, _ = certificate
    lower, upper, _ = (v[:7] for v in controller_limits(station))
    home, axes = world.initial_posture[:7], np.deg2rad(found["semi_axes_deg"])
    assert np.all(home + axes <= upper + 1e-9)
    assert np.all(home - axes >= lower - 1e-9)
    # Joint 4 is nearest to its limit: 105 - 83 deg.
    assert found["semi_axes_deg"][3] == pytest.approx(22.0)


def test_a_failure_is_no_certificate(certificate):
    found, _ = certificate
    assert not holds(found | {"failures_inside": 1})
    assert not holds(found | {"later_than_certified": 1})
    assert not holds(found | {"max_v_increase": 2 * found["v_tolerance"]})
    assert not holds(found | {"contraction_rate_measured_clear": 1.001 * found["contraction_rate"]})


def test_where_no_path_is_clear_there_is_nothing_to_certify(world, tmp_path, monkeypatch):
    rows = np.tile(world.initial_posture[:7], (2, 1))
    monkeypatch.setattr(
        return_certificate,
        "trajectories_home",
        lambda world, samples, *rest: [Trajectory(rows, "desk") for _ in samples],
    )
    with pytest.raises(InputError, match=r"each of 10 straight paths home .* touches something: raise --samples"):
        make(world, tmp_path)
