"""What makes a disturbance, as a scenario gives it."""

import pytest

from diagrams.world.disturbance import DisturbanceSpec
from models.errors import InputError

TARGET = [0.5] * 7


@pytest.mark.parametrize(
    "given",
    [
        DisturbanceSpec(),
        DisturbanceSpec("A"),  # sampled
        DisturbanceSpec("A", level=0.1, target=TARGET),
        DisturbanceSpec("B", level=0.1, hold_ticks=1),
        DisturbanceSpec("B", level=0.1, hold_ticks=5, subtask=2, can_moved_to=[0.5, 0.0]),
        DisturbanceSpec("moved"),
        DisturbanceSpec("moved", level=0.1, can_moved_to=[0.5, 0.0]),
        DisturbanceSpec("none", level=-1.0),  # nothing else of it is read
    ],
)
def test_disturbances(given):
    given.check()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (DisturbanceSpec("C"), "no disturbance 'C'"),
        (DisturbanceSpec("A", hold_ticks=3), "level is missing"),
        (DisturbanceSpec("A", level=0.0, target=TARGET), "level 0.0 is no distance"),
        (DisturbanceSpec("A", level=float("inf"), target=TARGET), "level inf is no distance"),
        (DisturbanceSpec("A", level=0.1), "target None does not fit disturbance A: give 7"),
        (DisturbanceSpec("A", level=0.1, target=[float("nan")] * 7), "does not fit"),
        (DisturbanceSpec("B", level=0.1, hold_ticks=2, target=TARGET), "give 0 joint angles"),
        (DisturbanceSpec("B", level=0.1), "hold_ticks 0 is too short"),
        (DisturbanceSpec("B", level=0.1, hold_ticks=5, subtask=3), "no subtask 3"),
        (DisturbanceSpec("B", level=0.1, hold_ticks=5, subtask=2, can_moved_to=[0.5]), "not two numbers"),
        (
            DisturbanceSpec("B", level=0.1, hold_ticks=5, subtask=1, can_moved_to=[0.5, 0.0]),
            "moves nothing under B in subtask 1",
        ),
        (
            DisturbanceSpec("B", level=0.1, hold_ticks=4, subtask=2, can_moved_to=[0.5, 0.0]),
            "moves nothing .* hold_ticks 4",
        ),
        (DisturbanceSpec("moved", level=0.1), "can_moved_to is missing"),
        (
            DisturbanceSpec("moved", 0.1, subtask=2, can_moved_to=[0.5, 0.0]),
            "moves nothing under moved in subtask 2",
        ),
        (DisturbanceSpec("moved", level=0.1, target=TARGET, can_moved_to=[0.5, 0.0]), "give 0 joint angles"),
        (
            DisturbanceSpec("A", level=0.1, target=TARGET, hold_ticks=5, subtask=2, can_moved_to=[0.5, 0.0]),
            "moves nothing under A",
        ),
    ],
)
def test_what_makes_no_disturbance_is_named(given, named):
    with pytest.raises(InputError, match=named):
        given.check()
