"""The certificate of mode return: hand-worked levels and rates, and a small proof on the plant."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.hybrid import return_certificate, return_loop
from diagrams.hybrid.return_certificate import (
    SAFETY_FACTOR,
    Lyapunov,
    certify,
    holds,
    save_certificate,
    servo_level,
)
from diagrams.hybrid.return_loop import ReturnLoop, Sample, Way, ways_home
from diagrams.world.station import controller_limits
from models.errors import InputError

PNG = b"\x89PNG\r\n\x1a\n"
UNITS = np.array([0.7, 0.5, 0.3, 0.7, 0.3, 0.5, 0.3])


@pytest.fixture(scope="module")
def lyapunov(world):
    return Lyapunov.of(world, UNITS)


@pytest.fixture(scope="module")
def loop(world):
    return ReturnLoop(world)


@pytest.fixture(scope="module")
def certificate(world, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ways")
    return certify(world, UNITS, samples=12, outside=4, seed=0, workers=1, folder=folder)


def test_riccati_by_hand(lyapunov):
    """Scalar: S^2 = q (S + r) with q = 1, r = 90 gives S = 10, K = 10 / 100, and V falls by (1 + 0.01 * 90) / 10 = 0.19 of itself."""
    assert np.diag(lyapunov.P) == pytest.approx(10.0 / UNITS**2, rel=1e-8)
    assert lyapunov.gain == pytest.approx(0.1 * np.eye(7), abs=1e-8)
    assert lyapunov.rate == pytest.approx(0.81, abs=1e-8)
    assert lyapunov.rate_with(0.0) == pytest.approx(0.81, abs=1e-8)
    # |m+| <= (0.9 + 0.5 * 0.1) |m|
    assert lyapunov.rate_with(0.5) == pytest.approx(0.95**2, abs=1e-8)
    assert lyapunov.value(UNITS) == pytest.approx(70.0)


def test_levels_by_hand(lyapunov):
    # Joint 3 reaches 0.3 rad on the level 10.
    assert lyapunov.level_within(np.eye(7), UNITS) == pytest.approx(10.0)
    assert lyapunov.level_within(np.eye(7), np.append(np.full(6, 9.0), 0.15)) == pytest.approx(2.5)
    # A step of 0.1 d within 0.07 rad: d within 0.7.
    assert lyapunov.level_within(lyapunov.gain, np.full(7, 0.07)) == pytest.approx(10.0)


def test_tracking_error_by_hand(lyapunov):
    home = np.zeros(7)
    ideal = np.array([0.9**k * UNITS for k in range(4)])
    assert lyapunov.relative_error(ideal, home) == pytest.approx(0.0, abs=1e-7)
    late = ideal.copy()
    late[1] = 0.92 * UNITS  # a fifth of the step is missing
    assert lyapunov.relative_error(late, home)[0] == pytest.approx(0.2)


def test_servo_level_is_where_contraction_ends(lyapunov):
    enough = 1.0 / SAFETY_FACTOR  # of the error leaves 0.9 + 0.1
    etas = np.array([0.1, 1.001 * enough, 0.999 * enough, 2.0])
    assert servo_level(np.array([1.0, 3.0, 2.0, 4.0]), etas, lyapunov) == 3.0
    assert servo_level(np.array([1.0]), np.array([0.1]), lyapunov) == np.inf


def test_samples_are_uniform_in_the_set(lyapunov):
    values = lyapunov.value(lyapunov.sample_inside(np.random.default_rng(0), 2.0, 4000))
    assert values.max() <= 2.0
    # In 7 dimensions the share below half the level is 2^-3.5.
    assert np.mean(values < 1.0) == pytest.approx(2**-3.5, abs=0.012)


def test_command_of_the_loop_is_the_regulators(loop, world):
    context = loop.diagram.CreateDefaultContext()
    history = loop.diagram.GetSubsystemByName("posture_history")
    local = history.GetMyMutableContextFromRoot(context)
    posture = world.initial_posture + np.array([0.2, -0.1, 0.0, 0.1, 0.3, -0.2, 0.1, -0.05])
    local.SetDiscreteState(0, posture)
    mixer = loop.diagram.GetSubsystemByName("regulated_mixer")
    command = mixer.GetOutputPort("desired_posture").Eval(mixer.GetMyContextFromRoot(context))
    assert command[:7] == pytest.approx((posture - 0.1 * (posture - world.initial_posture))[:7], abs=1e-9)
    assert command[7] == posture[7]  # the fingers keep their command


def test_way_home_is_replayed_bit_by_bit(loop, world):
    start = world.initial_posture[:7] + 0.05
    rows, broke_off = loop.run(start, np.array([0.5, 0.0]), "left")
    assert broke_off is None
    assert np.array_equal(rows, loop.run(start, np.array([0.5, 0.0]), "left")[0])
    assert np.array_equal(rows[0], start)
    assert np.abs(rows[-1] - world.initial_posture[:7]).max() < np.deg2rad(3.0)


def test_certificate_is_borne_out(certificate, world):
    found, _ = certificate
    assert holds(found)
    assert (found["samples_inside"], found["samples_outside"]) == (12, 4)
    assert (found["failures_inside"], found["later_than_certified"]) == (0, 0)
    assert 0.81 < found["contraction_rate"] < 1.0
    assert found["contraction_rate_measured"] <= found["contraction_rate"]
    assert found["max_v_increase"] <= found["v_tolerance"]
    assert found["level"] == min(v for v in found["levels"].values() if v is not None)
    assert {"any"} <= set(found["collision_share"])
    json.dumps(found, allow_nan=False)


def test_set_is_within_the_limits(certificate, world, station):
    found, _ = certificate
    lower, upper, _ = (v[:7] for v in controller_limits(station))
    home, axes = world.initial_posture[:7], np.deg2rad(found["semi_axes_deg"])
    assert np.all(home + axes <= upper + 1e-9)
    assert np.all(home - axes >= lower - 1e-9)
    # Joint 4 is nearest to its limit: 105 - 83 deg.
    assert found["semi_axes_deg"][3] == pytest.approx(22.0)


def test_certificate_is_drawn(certificate, world, tmp_path):
    save_certificate(certificate[1], world, tmp_path / "return.png")
    assert (tmp_path / "return.png").read_bytes().startswith(PNG)


def test_a_failure_is_no_certificate(certificate):
    found, _ = certificate
    assert not holds(found | {"failures_inside": 1})
    assert not holds(found | {"max_v_increase": 2 * found["v_tolerance"]})
    assert not holds(found | {"contraction_rate_measured_clear": 1.001 * found["contraction_rate"]})


def test_a_simulation_that_breaks_off_did_not_arrive(loop, world, monkeypatch):
    def breaks(time):
        raise RuntimeError("something is\nnon-finite")

    monkeypatch.setattr(loop, "simulator", SimpleNamespace(
        reset_context=loop.simulator.reset_context, get_mutable_context=loop.simulator.get_mutable_context,
        Initialize=loop.simulator.Initialize, AdvanceTo=breaks,
    ))  # fmt: skip
    home = world.initial_posture[:7]
    rows, broke_off = loop.run(home + 0.05, np.array([0.5, 0.0]), "left")
    assert broke_off == "something is non-finite"
    assert rows.shape == (1, 7)
    at_home = np.tile(home, (3, 1))
    assert Way(at_home, None).arrival(home) == 0
    assert Way(at_home, None, broke_off).arrival(home) == -1


def test_ways_survive_the_disk_and_are_not_run_again(world, tmp_path, monkeypatch):
    home = world.initial_posture[:7]
    samples = [Sample(home + 0.02 * k, np.array([0.55, 0.0]), "left") for k in range(3)]
    monkeypatch.setattr(return_loop, "CHUNK", 2)
    first = ways_home(world, samples, 1, "ways", tmp_path)
    parts = sorted(tmp_path.glob("*.npz"))
    assert len(parts) == 2
    parts[0].unlink()
    ran = []
    true = return_loop.ReturnWorker.way
    monkeypatch.setattr(return_loop.ReturnWorker, "way", lambda self, sample: ran.append(sample) or true(self, sample))
    again = ways_home(world, samples, 1, "ways", tmp_path)
    assert len(ran) in (1, 2)
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one.rows, other.rows)
        assert (one.touches, one.broke_off) == (other.touches, other.broke_off)


def test_where_no_way_is_clear_there_is_nothing_to_certify(world, tmp_path, monkeypatch):
    rows = np.tile(world.initial_posture[:7], (2, 1))
    monkeypatch.setattr(
        return_certificate, "ways_home", lambda world, samples, *rest: [Way(rows, "desk") for _ in samples]
    )
    with pytest.raises(InputError, match=r"each of 10 ways home .* touches something: raise --samples"):
        certify(world, UNITS, samples=12, outside=4, seed=0, workers=1, folder=tmp_path)
