"""What makes a disturbance, as a scenario gives it."""

import pytest

from diagrams.world.disturbance import Disturbance
from models.errors import InputError

TARGET = [0.5] * 7


@pytest.mark.parametrize(
    "given",
    [
        Disturbance(),
        Disturbance("A"),  # sampled
        Disturbance("A", level=0.1, target=TARGET),
        Disturbance("B", level=0.1, hold_ticks=1),
        Disturbance("B", level=0.1, hold_ticks=5, subtask=2, can_moved_to=[0.5, 0.0]),
        Disturbance("none", level=-1.0),  # nothing else of it is read
    ],
)
def test_disturbances(given):
    given.check()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (Disturbance("C"), "no disturbance 'C'"),
        (Disturbance("A", hold_ticks=3), "level is missing"),
        (Disturbance("A", level=0.0, target=TARGET), "level 0.0 is no distance"),
        (Disturbance("A", level=float("inf"), target=TARGET), "level inf is no distance"),
        (Disturbance("A", level=0.1), "target None does not fit disturbance A: give 7"),
        (Disturbance("A", level=0.1, target=[float("nan")] * 7), "does not fit"),
        (Disturbance("B", level=0.1, hold_ticks=2, target=TARGET), "give 0 joint angles"),
        (Disturbance("B", level=0.1), "hold_ticks 0 is too short"),
        (Disturbance("B", level=0.1, hold_ticks=5, subtask=3), "no subtask 3"),
        (Disturbance("B", level=0.1, hold_ticks=5, subtask=2, can_moved_to=[0.5]), "not two numbers"),
        (
            Disturbance("B", level=0.1, hold_ticks=5, subtask=1, can_moved_to=[0.5, 0.0]),
            "moves nothing under B in subtask 1",
        ),
        (
            Disturbance("B", level=0.1, hold_ticks=4, subtask=2, can_moved_to=[0.5, 0.0]),
            "moves nothing .* hold_ticks 4",
        ),
        (
            Disturbance("A", level=0.1, target=TARGET, hold_ticks=5, subtask=2, can_moved_to=[0.5, 0.0]),
            "moves nothing under A",
        ),
    ],
)
def test_what_makes_no_disturbance_is_named(given, named):
    with pytest.raises(InputError, match=named):
        given.check()
