"""Configuration: defaults, YAML over them, and one clear error for what does not fit."""

import numpy as np
import pytest

from diagrams.scenario import Grid, Scenario, ScenarioError, World, load_scenario


def test_a_file_goes_over_the_defaults(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("seed: 7\ncan: [0.5, 0.02]\nworld:\n  regulator: {input_weight: 45.0}\n")
    scenario = load_scenario(path)
    assert (scenario.seed, scenario.can, scenario.rnn) == (7, [0.5, 0.02], "lstm")
    assert scenario.world.regulator.input_weight == 45.0
    assert scenario.world.regulator.state_weight == 1.0
    assert scenario.world.timing.period == 0.1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("sed: 7", "sed"),
        ("world:\n  grid: {spacings: 0.1}", "spacings"),
        ("seed: many", "many"),
        ("seed: [", "does not fit"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, text, named):
    path = tmp_path / "scenario.yaml"
    path.write_text(text + "\n")
    with pytest.raises(ScenarioError, match=named) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"no scenario file .*none\.yaml"):
        load_scenario(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"rnn": "rnn"}, "no rnn 'rnn': choose one of lstm, gru, mtrnn"),
        ({"disturbance": "C"}, "no disturbance 'C': choose one of none, A, B"),
        ({"vacant": "up"}, "no vacant spot 'up': choose one of left, right"),
        ({"seed": -1}, "seed -1 is negative"),
        ({"can": [0.5]}, "does not have two numbers"),
    ],
)
def test_choices_are_checked(change, named):
    with pytest.raises(ScenarioError, match=named):
        Scenario(**change).check()


def test_the_defaults_pass():
    Scenario().check()


def test_half_of_the_grid_is_trained():
    grid = Grid()
    trained = grid.training_positions()
    assert trained.shape == (50, 2)
    assert len(np.unique(trained, axis=0)) == 50
    assert grid.position(9, 9) - grid.position(0, 0) == pytest.approx([0.18, 0.18])
    # No position is further from a trained one than its neighbour.
    every = np.array([grid.position(i, j) for i in range(10) for j in range(10)])
    nearest = np.linalg.norm(every[:, None] - trained, axis=2).min(axis=1)
    assert nearest.max() == pytest.approx(grid.spacing)


def test_initial_posture_is_in_radians_with_open_fingers():
    posture = World().initial_posture
    assert np.rad2deg(posture[:7]) == pytest.approx(World().initial_joints_deg)
    assert posture[7] == 0.08
