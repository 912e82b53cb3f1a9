"""PostureHistory: hand-worked numbers at the ticks."""

from pydrake.systems.analysis import Simulator

from systems.posture_history import PostureHistory
from tests.systems.system_checks import outputs


def test_posture_history_by_hand():
    system = PostureHistory(posture_size=2, horizon=2, period=0.5, initial_posture=[7.0, 8.0])
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    assert outputs(system, context)["posture_history"].tolist() == [7.0, 8.0] * 3
    port = system.GetInputPort("posture")
    port.FixValue(context, [1.0, 2.0])
    simulator.AdvanceTo(0.1)
    port.FixValue(context, [3.0, 4.0])
    simulator.AdvanceTo(0.4)  # no tick in between: held
    assert outputs(system, context)["posture"].tolist() == [1.0, 2.0]
    assert outputs(system, context)["posture_history"].tolist() == [1.0, 2.0, 7.0, 8.0, 7.0, 8.0]
    simulator.AdvanceTo(0.6)
    assert outputs(system, context)["posture"].tolist() == [3.0, 4.0]
    assert outputs(system, context)["posture_history"].tolist() == [3.0, 4.0, 1.0, 2.0, 7.0, 8.0]
