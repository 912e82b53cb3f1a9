"""The certificate of mode return: a small proof on the plant."""

import json

import numpy as np
import pytest

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid import return_certificate
from diagrams.hybrid.return_certificate import certify, words
from diagrams.hybrid.return_loop import Trajectory
from diagrams.hybrid.return_proof import KINDS, holds
from models.errors import InputError


def make(world, folder):
    with RowStore(folder / "t.jsonl", fingerprint(world)) as store, Pool(0) as pool:
        return certify(world, samples=10, draws=4, seed=0, pool=pool, store=store)


@pytest.fixture(scope="module")
def certificate(world, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(return_certificate.LEAST_CALIBRATION, "draws", 6)
        patch.setattr(return_certificate, "measured_delay_margin", lambda world, expected: expected + 1)
        return make(world, tmp_path_factory.mktemp("certificate"))


def test_certificate_is_borne_out(certificate):
    found, picture = certificate
    assert holds(found)
    assert (found["samples_inside"], found["failures_inside"], found["left_box_inside"]) == (10, 0, 0)
    assert (found["coverage_onsets"], found["coverage_targets"]) == (1.0, 1.0)
    assert found["bound_inside"] == pytest.approx(1 - 0.05 ** (1 / 10))
    assert (found["delay_margin_ticks"], found["delay_margin_measured_ticks"]) == (15, 16)
    for kind in KINDS:
        of_kind = found["sets"][kind]
        assert 0.9 <= of_kind["contraction_rate"] < 1.0
        assert of_kind["time_home_measured_s"]["max"] < of_kind["time_home_certified_s"] < 10.0
        assert of_kind["free"]["samples"] == len(picture["values"][kind])
        assert of_kind["all"]["samples"] - of_kind["free"]["samples"] <= of_kind["filtered"] + found["touches_inside"]
    assert found["sets"]["box"]["held"] == 5
    assert found["sets"]["onsets"]["contraction_rate"] < found["sets"]["box"]["contraction_rate"]
    assert found["touches_inside"] == 0
    assert found["nearest_distance_m"] > 0.005
    json.dumps(found)
    onsets = found["sets"]["onsets"]
    assert f"V falls to {onsets['free']['contraction_first_measured']:.4f} of itself at most" in words(found)
    filtered = {"onsets": onsets | {"free": onsets["free"] | {"samples": 0, "contraction_first_measured": 0.0}}}
    assert "none of them is the LQR's alone, so that its rate is not tested: raise" in words(found | {"sets": filtered})


def test_where_no_way_is_clear_there_is_nothing_to_certify(world, tmp_path, monkeypatch):
    rows = np.tile(world.initial_posture[:7], (2, 1))
    monkeypatch.setattr(
        return_certificate,
        "trajectories_home",
        lambda world, samples, *rest: [Trajectory(rows, -0.01, "desk", 0) for _ in samples],
    )
    monkeypatch.setattr(return_certificate, "LEAST_CALIBRATION", {"box": 1, "draws": 1})
    with pytest.raises(InputError, match=r"none of the ways home .* is free, .*: raise --samples"):
        make(world, tmp_path)
