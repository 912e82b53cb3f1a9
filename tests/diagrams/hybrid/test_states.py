"""The inventory of states, by hand and of the whole loop."""

import json

from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Integrator, ZeroOrderHold

from diagrams.hybrid.states import State, report, states_of, table


def test_inventory_by_hand():
    inner = DiagramBuilder()
    hold = inner.AddNamedSystem("hold", ZeroOrderHold(0.25, 3))
    inner.ExportInput(hold.get_input_port())
    nested = inner.Build()
    nested.set_name("nested")
    builder = DiagramBuilder()
    builder.AddSystem(nested)
    builder.AddNamedSystem("integrator", Integrator(2))
    builder.AddNamedSystem("memory", ZeroOrderHold(0.5, Value("text")))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    assert [s for s in states_of(diagram, context) if s.owner != "memory"] == [
        State("nested/hold", "ZeroOrderHold", "discrete", 0, 3, 0.25),
        State("integrator", "Integrator", "continuous", 0, 2, None),
    ]
    found = report(diagram, context)
    assert found["sums"] == {"continuous": 2, "discrete": 3, "abstract": 1, "discrete_groups": 1}
    assert found["agree"]


def test_inventory_of_the_whole_loop(rollout):
    context = rollout.diagram.CreateDefaultContext()
    found = report(rollout.diagram, context)
    assert found["agree"]
    assert found["sums"]["continuous"] == found["sums"]["abstract"] == 0
    owners = {}
    for state in found["states"]:
        owners[state["owner"]] = owners.get(state["owner"], 0) + state["size"]
    # Plant: 7 joints, 2 fingers, two free cans: 9 + 2 * 7 positions, 9 + 2 * 6 velocities.
    assert owners["station/plant"] == 23 + 21
    assert owners["disturbance"] == 1 + 8
    # N + 1 = 11 postures; what the detector said at the tick.
    assert owners["switched_controller/posture_history"] == 11 * 8
    assert (owners["switched_controller/alpha_hold"], owners["switched_controller/errors_hold"]) == (1, 11)
    periods = {state["owner"]: state["period"] for state in found["states"]}
    assert periods.pop("station/plant") == 0.0125
    assert set(periods.values()) == {0.1}
    assert "the root Context agrees" in table(found)
    json.dumps(found)
