"""PostureHistory: hand-worked numbers at the ticks."""

from pydrake.systems.analysis import Simulator

from systems.posture_history import PostureHistory
from tests.systems.system_checks import outputs


def test_posture_history_by_hand():
    system = PostureHistory(posture_size=2, horizon=1, period=0.5, initial_posture=[7.0, 8.0])
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    port = system.GetInputPort("posture")

    def see(posture):
        port.FixValue(context, posture)
        found = outputs(system, context)
        return found["posture"].tolist(), found["posture_history"].tolist()

    # Before tick 0: now, then N + 1 = 2 samples.
    assert see([1.0, 2.0]) == ([7.0, 8.0], [1.0, 2.0, 7.0, 8.0, 7.0, 8.0])
    simulator.AdvanceTo(0.1)
    # No tick in between: the samples are held, the first row is what is now.
    assert see([3.0, 4.0]) == ([1.0, 2.0], [3.0, 4.0, 1.0, 2.0, 7.0, 8.0])
    simulator.AdvanceTo(0.6)
    assert see([5.0, 6.0]) == ([3.0, 4.0], [5.0, 6.0, 3.0, 4.0, 1.0, 2.0])
