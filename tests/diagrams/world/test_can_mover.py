"""The can is put elsewhere by an event of the plant, in the middle of a tick; and when it is."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from diagrams.world.can_mover import CanMover
from diagrams.world.disturbance import CAN_TAKEN_TICKS, DisturbanceSpec
from diagrams.world.names import CAN_HALF_HEIGHT, CANS
from diagrams.world.station import can_body

PLACE = [0.61, 0.05]


def simulation(station, place):
    """The arm is still, and the can to pick falls on the desk, tumbling."""
    context = station.CreateDefaultContext()
    station.GetInputPort("desired_posture").FixValue(context, station.world.initial_posture)
    if place is not None:
        station.GetInputPort("can_place").FixValue(context, place)
    plant, body = station.plant, can_body(station.plant, CANS[0])
    own = plant.GetMyMutableContextFromRoot(context)
    q, v = plant.GetPositions(own).copy(), plant.GetVelocities(own).copy()
    q[body.floating_positions_start() + 6] += 0.5
    v[body.floating_velocities_start_in_v() :][:6] = 1.0, 2.0, 3.0, 0.1, 0.2, 0.3
    plant.SetPositionsAndVelocities(own, np.append(q, v))
    return Simulator(station, context)


def state(station, simulator):
    return station.plant.GetPositionsAndVelocities(station.plant.GetMyContextFromRoot(simulator.get_context())).copy()


@pytest.mark.parametrize("tick", [0, 3])
def test_the_can_is_put_there_in_the_middle_of_the_tick(station, tick):
    timing, plant, body = station.world.timing, station.plant, can_body(station.plant, CANS[0])
    simulator, left = simulation(station, [np.nan, np.nan]), simulation(station, None)
    middle, step = (tick + 0.5) * timing.period, timing.time_step
    for each in (simulator, left):
        each.AdvanceTo(middle - 1.25 * step)
    assert state(station, simulator).tobytes() == state(station, left).tobytes()  # NaN is as good as no input
    station.GetInputPort("can_place").FixValue(
        station.GetMyMutableContextFromRoot(simulator.get_mutable_context()), PLACE
    )
    for each in (simulator, left):
        each.AdvanceTo(middle - 0.75 * step)
    assert state(station, simulator).tobytes() == state(station, left).tobytes()
    for each in (simulator, left):
        each.AdvanceTo(middle - 0.25 * step)
    # Upright, at rest; nothing else has changed.
    expected = state(station, left)
    expected[body.floating_positions_start() :][:7] = 1, 0, 0, 0, *PLACE, CAN_HALF_HEIGHT
    expected[plant.num_positions() + body.floating_velocities_start_in_v() :][:6] = 0.0
    assert np.array_equal(state(station, simulator), expected)


@pytest.mark.parametrize(
    ("given", "tick"),
    [
        (DisturbanceSpec("B", 0.1, hold_ticks=9, subtask=2, can_moved_to=PLACE), CAN_TAKEN_TICKS - 1),
        (DisturbanceSpec("moved", 0.1, can_moved_to=PLACE), 0),
    ],
)
def test_it_is_taken_in_the_fifth_tick_of_the_stop_and_moved_in_the_first(given, tick):
    mover = CanMover()
    context = mover.CreateDefaultContext()

    def outputs(ticks):
        mover.get_input_port().FixValue(context, [ticks])
        return mover.GetOutputPort("can_place").Eval(context).tolist(), mover.GetOutputPort("taken").Eval(context)[0]

    assert CAN_TAKEN_TICKS == 5
    for ticks in range(-1, 7):  # without a place
        assert outputs(ticks)[1] == 0.0
        assert np.isnan(outputs(ticks)[0]).all()
    mover.set_parameters(context, given)
    for ticks in range(-1, tick):
        assert np.isnan(outputs(ticks)[0]).all()
        assert outputs(ticks)[1] == 0.0
    assert outputs(tick) == (PLACE, 1.0)
    assert np.isnan(outputs(tick + 1)[0]).all()
    assert outputs(tick + 1)[1] == 1.0
    mover.set_parameters(context, DisturbanceSpec())
    assert outputs(tick + 1)[1] == 0.0
