"""RecurrentPolicy: hand-worked numbers at the ticks, and what is refused."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from systems.recurrent_policy import RecurrentPolicy
from tests.systems.controller_fakes import PERIOD, FakePolicy
from tests.systems.system_checks import outputs


def test_recurrent_policy_by_hand():
    policy = FakePolicy(joints=1, feature_size=1, horizon=2, drift=0.25, nonsense=0.125)
    initial = policy.scaling.scale(policy.initial_posture)
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    found = outputs(system, context)
    assert found["predicted_posture"] == pytest.approx(initial)
    assert found["predicted_features"].tolist() == [0.0]
    assert found["hidden_state"] == pytest.approx(policy.initial_state)
    assert found["recalled_postures"] == pytest.approx(np.tile(initial, 3))  # where the arm rests

    port = system.GetInputPort("network_input")
    port.FixValue(context, [0.5, -0.25, 1.0])
    simulator.AdvanceTo(0.5 * PERIOD)
    found = outputs(system, context)
    assert found["predicted_posture"].tolist() == [0.75, 0.0]
    assert found["predicted_features"].tolist() == [0.5]
    # Row 0: the prediction of the next tick; rows 1, 2: recalled from the new hidden state.
    expected = np.concatenate(([0.75, 0.0], initial + 0.125, initial + 0.125))
    assert found["recalled_postures"] == pytest.approx(expected)

    port.FixValue(context, [1.0, -2.0, 4.0])
    simulator.AdvanceTo(1.5 * PERIOD)
    found = outputs(system, context)
    assert found["predicted_posture"].tolist() == [1.0, -1.0]  # 1.25, -1.75 clipped
    assert found["predicted_features"].tolist() == [1.0]  # 2 clipped
    expected = np.concatenate(([1.0, -1.0], [0.625, -0.125], initial + 0.125))
    assert found["recalled_postures"] == pytest.approx(expected)


def test_recurrent_policy_stops_at_values_that_are_not_finite():
    policy = FakePolicy()
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    system.GetInputPort("network_input").FixValue(simulator.get_mutable_context(), np.full(8, np.nan))
    with pytest.raises(ValueError, match=r"t = 0 s has values that are not finite.*check the weights"):
        simulator.AdvanceTo(0.01)


def test_recurrent_policy_stops_at_a_recall_of_another_shape():
    policy = FakePolicy()
    step = policy.step
    policy.step = lambda x, state: (*step(x, state)[:2], np.zeros((2, 3)))
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    system.GetInputPort("network_input").FixValue(simulator.get_mutable_context(), np.zeros(8))
    with pytest.raises(ValueError, match=r"recalled shape \(2, 3\); its horizon and posture_size ask for \(2, 4\)"):
        simulator.AdvanceTo(0.01)


def test_a_policy_that_writes_to_its_state_does_no_harm():
    policy = FakePolicy()
    step = policy.step

    def writing_step(x, state):
        found = step(x, state)
        state[:] = 1e9
        return found

    policy.step = writing_step
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("network_input").FixValue(context, np.zeros(8))
    for k in range(2):
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        assert np.abs(outputs(system, context)["hidden_state"]).max() < 2.0


def test_reset_takes_c_0_and_forgets_a_row_a_tick():
    """N is 2: after a tick the prediction is the initial posture, after three all that is recalled."""
    policy = FakePolicy(horizon=2)
    system = RecurrentPolicy(policy, PERIOD)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    before = outputs(system, context)
    system.GetInputPort("network_input").FixValue(context, np.full(8, 0.5))
    system.GetInputPort("reset").FixValue(context, [0.0])
    simulator.AdvanceTo(0.5 * PERIOD)
    stepped = outputs(system, context)["recalled_postures"].reshape(3, 4)
    system.GetInputPort("reset").FixValue(context, [1.0])
    home = before["predicted_posture"]
    for k, rows in ((1, [home, stepped[0], stepped[1]]), (2, [home, home, stepped[0]]), (3, [home] * 3)):
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        after = outputs(system, context)
        for name in ("hidden_state", "predicted_posture", "predicted_features"):
            assert np.array_equal(after[name], before[name])
        assert np.array_equal(after["recalled_postures"].reshape(3, 4), rows)
    assert len(policy.inputs) == 1


def test_set_memory_puts_the_network_where_a_step_had_left_it():
    rng, policy = np.random.default_rng(0), FakePolicy()
    system = RecurrentPolicy(policy, PERIOD)
    context = system.CreateDefaultContext()
    hidden, predicted, recalled = rng.normal(size=12), rng.normal(size=8), rng.normal(size=(2, 4))
    system.set_memory(context, hidden, predicted, recalled)
    found = outputs(system, context)
    assert np.array_equal(found["hidden_state"], hidden)
    assert np.array_equal(found["predicted_posture"], predicted[:4])
    assert np.array_equal(found["predicted_features"], predicted[4:])
    assert np.array_equal(found["recalled_postures"], np.vstack((predicted[:4], recalled)).ravel())
