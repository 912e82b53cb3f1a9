"""Configuration: defaults, YAML over them, and one clear error for what does not fit."""

import numpy as np
import pytest

from diagrams.world.configuration import Grid, Timing, World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.scenario import Scenario, load_scenario, load_world
from models.errors import InputError


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
    with pytest.raises(InputError, match=named) as caught:
        load_scenario(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no scenario file .*none\.yaml"):
        load_scenario(tmp_path / "none.yaml")


def test_a_refused_world_is_told_by_its_file(tmp_path):
    (tmp_path / "w.yaml").write_text("grid: {count: 1}")
    with pytest.raises(InputError, match=r"world\.grid\.count is 1") as refused:
        load_world(tmp_path / "w.yaml")
    assert refused.value.__notes__ == [f"the world file is {tmp_path / 'w.yaml'}"]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"rnn": "no.module:Network"}, "the network 'no.module:Network' cannot be loaded"),
        ({"detector": "ear"}, "no detector 'ear': choose from recall, knn, subspace"),
        ({"disturbance": DisturbanceSpec("C")}, "no disturbance 'C': choose from none, A, B"),
        ({"vacant": "up"}, "no vacant spot 'up': choose one of left, right"),
        ({"seed": -1}, "seed -1 is negative"),
        ({"can": [0.5]}, "does not have two numbers"),
    ],
)
def test_choices_are_checked(change, named):
    with pytest.raises(InputError, match=named):
        Scenario(**change).check()


@pytest.mark.parametrize(
    ("part", "values", "named"),
    [
        ("timing", {"time_step": 0.0}, "world.timing.time_step is 0.0"),
        ("timing", {"period": float("nan")}, "world.timing.period is nan"),
        ("timing", {"time_step": 0.01}, "time_step 0.01 s: some ticks, every 0.1 s,.* choose 0.0125, a"),
        ("timing", {"period": 0.015}, "time_step 0.0125 s: .* choose 0.015, a"),
        ("timing", {"time_step": 1e-320}, "time_step 1e-320 s: .* choose 9.765625e-05, a"),
        ("timing", {"period": 0.001}, "time_step 0.0125 s: .* choose 0.001, a"),
        ("servo", {"stiffness": [1.0, 2.0]}, "world.servo.stiffness has shape"),
        ("servo", {"damping": [-1.0] * 7}, "world.servo.damping is"),
        ("servo", {"finger_stiffness": float("inf")}, "world.servo.finger_stiffness is inf"),
        ("camera", {"width": 100}, "world.camera.width is 100"),
        ("camera", {"height": 0}, "world.camera.height is 0"),
        ("camera", {"height": 10**9, "width": 10**9}, "world.camera.width is 1000000000; .* at most 2048"),
        ("camera", {"field_of_view_deg": 180.0}, "no angle of view"),
        ("grid", {"corner": [0.4]}, "world.grid.corner has shape"),
        ("grid", {"corner": [0.4, float("inf")]}, "world.grid.corner is"),
        ("grid", {"corner": [1e308, 0.0]}, "world.grid.corner 1e[+]308 is too large: choose at most 10"),
        ("grid", {"spacing": 0.0}, "world.grid.spacing is 0.0"),
        ("regulator", {"acceleration": 0.5}, "world.regulator.acceleration 0.5 is too small: choose 1.0 or more"),
        ("regulator", {"acceleration": float("nan")}, "world.regulator.acceleration nan is no number"),
        ("regulator", {"acceleration": 1e7}, "world.regulator.acceleration 10000000.0 is too large: choose at most"),
        ("regulator", {"offset": -0.1}, "world.regulator.offset -0.1 is too small: choose 0.0 or more"),
        ("regulator", {"offset": 0.3}, "world.regulator.offset 0.3 is too large: choose at most 0.2"),
        ("grid", {"spacing": 1e308}, "world.grid.spacing 1e[+]308 is too large: choose at most 10"),
        ("grid", {"count": 1}, "world.grid.count is 1"),
        ("grid", {"count": 10**6}, "world.grid.count is 1000000; .* at most 100"),
        ("regulator", {"input_weight": 0.0}, "world.regulator.input_weight is 0.0"),
        ("clearance", {"cans": "seen"}, "no cans 'seen' .*choose from possible, known, unseen"),
        ("clearance", {"gap": 0.004}, "least 0.005 m, gap 0.004 m .* do not fit"),
        ("clearance", {"slip": -0.01}, "slip -0.01 m, .* do not fit: .*a slip of 0 or more"),
        ("clearance", {"slip": 0.14}, "gap 0.01 m and slip 0.14 m, .* do not fit: .*gap [+] slip < 0.15 m"),
        ("clearance", {"slip": float("nan")}, "slip nan m, .* do not fit"),
        ("clearance", {"rate": 1.5}, "rate 1.5 do not fit"),
        ("clearance", {"gap": float("nan")}, "world.clearance.gap is nan"),
        (None, {"resumption": "anew"}, "no resumption 'anew' .*choose from reset, imagined"),
        (None, {"initial_joints_deg": [1.0]}, "world.initial_joints_deg has shape"),
        (None, {"opening": 0.02}, "opening 0.02 m do not fit"),
        (None, {"close_below": 0.02}, "close_below 0.02 m and open_above 0.065 m do not fit.*opening 0.08"),
        (None, {"opening": 1.5}, "opening 1.5 m do not fit: choose 0 <= closed_opening < opening <= 1.0"),
        (None, {"empty_below": 0.03}, "empty_below 0.03 m does not fit.*more than closed_opening 0.03.*or 0"),
        (None, {"empty_below": 0.05}, "empty_below 0.05 m does not fit.*at most close_below 0.045"),
        (None, {"open_above": 0.045}, "open_above 0.045 m do not fit"),
        (None, {"open_above": 0.09}, "open_above 0.09 m do not fit"),
    ],
)
def test_what_is_no_world_is_named(part, values, named):
    scenario = Scenario()
    for name, value in values.items():
        setattr(scenario.world if part is None else getattr(scenario.world, part), name, value)
    with pytest.raises(InputError, match=named):
        scenario.check()


def test_the_defaults_pass():
    Scenario().check()


@pytest.mark.parametrize("period", [0.1, 0.07, 1 / 3, 2.5])
@pytest.mark.parametrize("halvings", range(7))
def test_halves_of_a_period_meet_every_tick(period, halvings):
    World(timing=Timing(period, period / 2**halvings)).check()


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
