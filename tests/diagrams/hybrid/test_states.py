"""The inventory of states, by hand and of the whole loop; the graph's readable form; the analysis' command line."""

import json
import subprocess
import sys

import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Integrator, ZeroOrderHold

from diagrams.analysis import ITEMS, main, parse
from diagrams.drawing.graph import readable
from diagrams.episodes import rollout as rollout_module
from diagrams.hybrid.states import State, inventory, report, table
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.untrained import save_untrained


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
    assert [s for s in inventory(diagram, context) if s.owner != "memory"] == [
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
    # Of alpha and of the posture: the last sample, and the history.
    assert owners["switched_controller/alpha_history"] == 1 + 8
    assert owners["disturbance"] == 1 + 8
    assert owners["switched_controller/posture_history"] == 8 + 11 * 8
    periods = {state["owner"]: state["period"] for state in found["states"]}
    assert periods.pop("station/plant") == pytest.approx(0.01)
    assert set(periods.values()) == {0.1}
    assert "the root Context agrees" in table(found)
    json.dumps(found)


def test_graph_shows_wired_ports_with_names(rollout):
    text = readable(rollout.diagram.GetGraphvizString(max_depth=2, options={"plant/split": "I/O"}))
    assert "rankdir=LR" in text
    assert "WorldModelInstance" not in text
    assert "applied_spatial_force" not in text
    for anonymous in (">u0<", ">y0<", ">u1<", ">u<", ">y<"):
        assert anonymous not in text
    for name in ("arm_desired_state", "predicted_features", "recalled_postures", "last_alphas", "posture_scaling"):
        assert f">{name}<" in text


def test_items_are_those_of_the_issue():
    assert list(ITEMS) == ["modes", "return", "linearize", "guard", "falsify", "states"]
    for name in ITEMS:
        item = parse([name, "--seed", "3", "--out", "there"])
        assert (item.seed, str(item.out)) == (3, "there")
    assert parse(["return"]).samples == 10_000


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["states", "--seed", "-1"], "seed -1 is negative"),
        (["states", "--rnn", "rnn"], "no rnn 'rnn'"),
        (["return", "--samples", "0"], "--samples 0 is too small"),
        (["guard", "--grid", "4"], "--grid 4 is even"),
        (["guard", "--joints", "1", "9"], "two different joints"),
        (["linearize", "--vacant", "up"], "--vacant one of left, right"),
    ],
)
def test_bad_input_is_named(tmp_path, arguments, named):
    with pytest.raises(InputError, match=named):
        main(parse([*arguments, "--out", str(tmp_path)]))


def test_bad_input_is_one_line_and_code_2(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "diagrams" / "analysis.py"), "modes", "--record", "none.npz"], cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: there is no record none.npz: write one with `pick_place.py --log FILE.npz`"
    ]


def test_states_writes_its_files(tmp_path, capsys):
    folder = save_untrained(tmp_path / "weights")
    assert main(parse(["states", "--weights", str(folder), "--out", str(tmp_path / "out")])) == 0
    found = json.loads((tmp_path / "out" / "states.json").read_text())
    assert found["agree"]
    assert "switched_controller/recurrent_policy" in capsys.readouterr().out
    assert "<svg" in (tmp_path / "out" / "graph.svg").read_text()


def test_modes_runs_an_episode_where_there_is_no_record(tmp_path, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 2.0)
    folder = save_untrained(tmp_path / "weights")
    out = tmp_path / "out"
    assert main(parse(["modes", "--weights", str(folder), "--disturbance", "none", "--out", str(out)])) == 0
    found = json.loads((out / "modes.json").read_text())
    assert found["runs"] == 1
    assert found["final_modes"]["return"] == 1  # the detector notices everything
    assert (out / "modes.png").is_file()
    assert main(parse(["modes", "--record", str(out), "--out", str(tmp_path / "again")])) == 0
    again = json.loads((tmp_path / "again" / "modes.json").read_text())
    assert again["sequences"] == found["sequences"]


def test_linearize_and_guard_with_untrained_networks(tmp_path):
    folder = save_untrained(tmp_path / "weights")
    weights, encoder = str(folder / "lstm.safetensors"), str(folder / "cae.safetensors")
    out = tmp_path / "out"
    asked = ["linearize", "--weights", weights, "--encoder", encoder, "--samples", "1", "--out", str(out)]
    assert main(parse(asked)) in (0, 1)
    found = json.loads((out / "linearize.json").read_text())
    assert set(found) >= {"spectral_radius", "decay_predicted", "decay_measured", "jacobian_error"}
    assert len(found["cases"]) == 2
    assert found["jacobian_error"] < 1e-5
    # A detector that notices everything has no learned way to be displaced from.
    with pytest.raises(InputError, match="is in mode return"):
        main(parse(["guard", "--weights", str(folder), "--out", str(out)]))


def test_return_writes_the_fields_of_the_issue(tmp_path):
    folder = save_untrained(tmp_path / "weights")
    asked = ["return", "--weights", str(folder), "--samples", "4", "--outside", "2", "--workers", "1"]
    assert main(parse([*asked, "--out", str(tmp_path / "out")])) == 0
    found = json.loads((tmp_path / "out" / "return.json").read_text())
    assert set(found) >= {
        "samples_inside", "failures_inside", "samples_outside", "failures_outside", "contraction_rate",
        "max_v_increase", "collision_share", "v_tolerance",
    }  # fmt: skip
