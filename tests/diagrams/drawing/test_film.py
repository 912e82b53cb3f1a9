"""The film: the ticks around the disturbance, the ghost where the network imagines the arm, alpha as a bar."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from diagrams.drawing import FILM_FORMATS
from diagrams.drawing.film import SIZE, film_frames, save_film
from diagrams.world.configuration import World
from tests.diagrams.recorded_run import recorded_run


def still(world, away=0.0):
    """The arm at home; the ghost `away` (rad) from it at joint 1; the cans on the desk."""
    record = recorded_run(56)
    n = len(record.time)
    posture, step = np.tile(world.initial_posture, (n, 1)), np.zeros((n, 8))
    step[:, 0] = away
    cans = np.tile([1, 0, 0, 0, 0.5, 0.0, 0.05, 1, 0, 0, 0, 0.25, 0.43, 0.1], (n, 1))
    return replace(record, posture=posture, rnn_step=step, regulator_step=0 * step, can_poses=cans)


@pytest.fixture(scope="module")
def together():
    """Ticks 24 to 55: disturbed from tick 39 on, alpha 1 from 41 on."""
    return np.array(film_frames(still(World()), World()), float)


def test_frames_are_those_around_the_disturbance(together):
    assert together.shape == (55 - (39 - 15) + 1, SIZE[1], SIZE[0], 3)


def test_the_ghost_is_blue_and_where_it_is_imagined(together):
    apart = np.array(film_frames(still(World(), 0.7), World())[3], float)[:-40]
    gained = apart - together[3, :-40]
    covered = gained[:, :, 0] < -40  # by something that is not red
    assert 1000 < covered.sum() < 40_000
    assert gained[covered][:, 2].mean() > gained[covered][:, 0].mean() + 40  # but blue


def test_the_bar_is_as_long_as_alpha(together):
    before, away = (together[k, -16, 75:175] for k in (5, 25))  # ticks 29 and 49
    assert np.all(before == 225)  # grey: empty
    assert np.all(away == [197, 48, 48])


@pytest.mark.parametrize("ending", FILM_FORMATS)
def test_a_film_is_written(tmp_path, ending):
    """Frames that are the same are one that stays longer."""
    path = tmp_path / "new" / f"film{ending}"
    save_film(still(World()), World(), path)
    with Image.open(path) as film:
        assert film.size == SIZE
        assert film.n_frames >= 3  # before, disturbed, under the LQR
