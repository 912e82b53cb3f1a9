"""The faults of the camera: numbers worked out by hand."""

import cv2
import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagrams.world.faults.registry import FAULTS
from tests.systems.faults.fault_cases import PERIOD, SETTING, SIZE, context_of, evaluate, picture, seen

GREY = np.full((SIZE, SIZE, 3), 100, np.uint8)
RAMP = np.repeat(np.arange(0, 4 * SIZE, 4, dtype=np.uint8)[None, :, None], SIZE, axis=0).repeat(3, axis=2)


def test_gain_is_one_factor_up_or_down():
    found = {int(seen("camera_gain", GREY, 0.5, seed=seed).max()) for seed in range(12)}
    assert found == {80, 120}
    brighter = next(seed for seed in range(12) if seen("camera_gain", GREY, 1.0, seed=seed).max() > 100)
    bright = seen("camera_gain", RAMP, 1.0, seed=brighter)
    assert bright.tolist() == np.minimum(np.rint(1.4 * RAMP), 255).tolist()


def test_colour_moves_one_channel_by_all_of_it():
    for seed in range(5):
        factors = seen("camera_colour", GREY, 0.5, seed=seed)[0, 0] / 100.0 - 1.0
        assert np.abs(factors).max() == pytest.approx(0.2)
        assert len(set(factors)) == 3


def test_shadow_darkens_one_side():
    found = seen("camera_shadow", GREY, 1.0)
    assert set(found[found < 100]) >= {30}
    dark, lit = np.mean(found == 30), np.mean(found == 100)
    assert 0.25 < dark < 0.65
    assert 0.25 < lit < 0.65


def test_blur_is_a_gaussian():
    spot = np.zeros((SIZE, SIZE, 3), np.uint8)
    spot[SIZE // 2, SIZE // 2] = 255
    wide = spot.copy()
    wide[20:36, 20:36] = 200
    sigma = 3.0 / 112.0 * SIZE
    assert seen("camera_blur", wide, 1.0).tolist() == cv2.GaussianBlur(wide, (0, 0), sigma).tolist()


def test_noise_has_its_spread_and_is_new_in_each_tick():
    first, again, next_one = (seen("camera_noise", GREY, 0.5, ticks=ticks).astype(float) for ticks in (3, 3, 4))
    assert first.std() == pytest.approx(15.0, rel=0.05)
    assert first.mean() == pytest.approx(100.0, abs=0.6)
    assert np.array_equal(first, again)
    assert np.corrcoef(first.ravel(), next_one.ravel())[0, 1] == pytest.approx(0.0, abs=0.05)


def test_occlusion_is_a_square_of_its_side():
    for seed in range(5):
        rows, columns = np.nonzero(seen("camera_occlusion", GREY, 0.5, seed=seed)[:, :, 0] == 90)
        assert len(rows) == (SIZE // 4) ** 2
        assert (np.ptp(rows), np.ptp(columns)) == (SIZE // 4 - 1, SIZE // 4 - 1)


def test_dropped_frames_are_as_many_as_the_severity_says():
    black = [not seen("camera_dropped", GREY, 0.3, ticks=k, hold=400).any() for k in range(400)]
    assert np.mean(black) == pytest.approx(0.3, abs=0.07)
    assert not seen("camera_dropped", GREY, 1.0).any()


def test_shift_is_by_its_pixels():
    """Of a ramp that rises by 4 a pixel in x, every inner pixel changes by 4 times the shift in x."""
    by = 3.0 / 112.0 * SIZE
    inner = np.s_[10:-10, 10:-10]
    found = []
    for seed in range(6):
        across, down = (
            np.mean(seen("camera_shift", ramp, 1.0, seed=seed)[inner].astype(float) - ramp[inner]) / 4.0
            for ramp in (RAMP, RAMP.transpose(1, 0, 2).copy())
        )
        assert np.hypot(across, down) == pytest.approx(by, abs=0.2)  # a quarter of a level is lost to rounding
        found.append(np.arctan2(across, down))
    assert np.ptp(found) > 1.0


def late(severity, ticks=8, onset=4):
    """At tick k the picture is all 100 + k: what is seen at each tick, before its updates."""
    system, found = FAULTS["camera_latency"](SETTING), []
    simulator = Simulator(system, context_of(system, severity))
    context = simulator.get_mutable_context()
    for k in range(ticks):
        system.GetInputPort("rgb_image").FixValue(context, picture(100 + k))
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(max(k - 1 - onset, -1))])
        found.append(int(system.GetOutputPort("faulty_rgb_image").Eval(context).data[0, 0, 0]) - 100)
        simulator.AdvanceTo((k + 0.5) * PERIOD)
    return found


@pytest.mark.parametrize(("severity", "ticks"), [(1.0, 3), (0.5, 2), (1 / 3, 1), (0.01, 1), (0.0, 0)])
def test_latency_is_whole_ticks(severity, ticks):
    assert late(severity) == [0, 1, 2, 3, 4, 5 - ticks, 6 - ticks, 7 - ticks]


def test_latency_from_the_first_tick_on_gives_what_there_is():
    assert late(1.0, onset=-2) == [0, 0, 0, 0, 1, 2, 3, 4]


def test_frozen_is_the_picture_of_the_onset():
    system, found = FAULTS["camera_frozen"](SETTING), []
    simulator = Simulator(system, context_of(system, 1.0, hold=3))
    context = simulator.get_mutable_context()
    for k in range(9):
        system.GetInputPort("rgb_image").FixValue(context, picture(k))
        system.GetInputPort("ticks_since_onset").FixValue(context, [float(max(k - 1 - 3, -1))])
        found.append(int(system.GetOutputPort("faulty_rgb_image").Eval(context).data[0, 0, 0]))
        simulator.AdvanceTo((k + 0.5) * PERIOD)
    assert found == [0, 1, 2, 3, 3, 3, 3, 7, 8]


def test_a_picture_stays_opaque():
    found = evaluate("camera_gain", "faulty_rgb_image", {"rgb_image": GREY}, 1.0)
    assert np.all(found.data[:, :, 3] == 255)
