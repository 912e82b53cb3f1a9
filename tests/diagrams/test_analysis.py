"""The program: its command line, and each analysis on networks that learned nothing."""

import json
import subprocess
import sys
from functools import partialmethod

import pytest

from diagrams.analysis import ANALYSES, main, parse
from diagrams.episodes.rollout import Rollout
from diagrams.hybrid import return_certificate
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.untrained import save_untrained


@pytest.fixture
def weights(tmp_path):
    """A folder of networks that learned nothing."""
    return str(save_untrained(tmp_path / "weights"))


@pytest.mark.parametrize("name", ANALYSES)
def test_every_analysis_takes_the_common_options(name):
    arguments = parse([name, "--seed", "3", "--out", "there", "--world", "s.yaml"])
    assert (arguments.seed, str(arguments.out), str(arguments.world)) == (3, "there", "s.yaml")
    assert type(arguments) is ANALYSES[name]


def test_options_of_the_analyses(tmp_path):
    assert [path.name for path in parse(["modes", "--records", "a.npz", "b"]).records] == ["a.npz", "b"]
    arguments = parse(["linearize", "--policies", "a.onnx", "b.onnx", "--encoder", "c.onnx"])
    assert [path.name for path in arguments.policies] == ["a.onnx", "b.onnx"]
    (tmp_path / "gru.onnx").touch()
    arguments = parse(["falsify", "--rnn", "gru", "--weights", str(tmp_path)])
    assert arguments.policy_path == tmp_path / "gru.onnx"
    assert parse(["guard", "--joints", "2", "3"]).joints == (2, 3)
    assert parse(["return", "--samples", "5", "--draws", "3"]).draws == 3


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["states", "--seed", "-1"], "--seed -1 is too small: choose 0 or more"),
        (["states", "--rnn", "rnn"], "no network 'rnn'"),
        (["states", "--world", "none.yaml"], r"no world file none\.yaml"),
        (["return", "--samples", "0"], "--samples 0 is too small: choose 1 or more"),
        (["return", "--draws", "0"], "--draws 0 is too small: choose 1 or more"),
        (["modes", "--max-crossings", "-1"], "--max-crossings -1 is too small"),
        (["guard", "--grid", "4"], "--grid 4 is even"),
        (["guard", "--joints", "1", "9"], "two different joints"),
        (["linearize", "--vacant", "up"], "--vacant one of left, right"),
        (["falsify", "--workers", "-1"], "--workers -1 is too small"),
    ],
)
def test_bad_input_is_named(tmp_path, arguments, named):
    with pytest.raises(InputError, match=named):
        main(parse([*arguments, "--out", str(tmp_path)]))


def test_a_folder_that_cannot_be_made_is_named():
    with pytest.raises(InputError, match=r"/dev/null/there cannot be written .*: choose another --out"):
        main(parse(["states", "--out", "/dev/null/there"]))


def test_bad_input_is_one_line_and_code_2(tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "diagrams" / "analysis.py"), "modes", "--records", "none.npz"], cwd=tmp_path,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: there is no record none.npz: write one with `pick_place.py --record FILE.npz`"
    ]


def test_states_writes_its_files(tmp_path, weights, capsys):
    out = tmp_path / "out"
    assert main(parse(["states", "--weights", weights, "--out", str(out)])) == 0
    assert json.loads((out / "states.json").read_text())["agree"]
    assert "switched_controller/recurrent_policy" in capsys.readouterr().out
    assert "<svg" in (out / "graph.svg").read_text()


def test_the_world_is_that_of_the_file(tmp_path, weights):
    (tmp_path / "s.yaml").write_text("timing: {time_step: 0.00625}\n")
    asked = ["states", "--weights", weights, "--world", str(tmp_path / "s.yaml"), "--out", str(tmp_path)]
    assert main(parse(asked)) == 0
    periods = {s["owner"]: s["period"] for s in json.loads((tmp_path / "states.json").read_text())["states"]}
    assert periods["station/plant"] == 0.00625


def test_modes_runs_an_episode_where_there_is_no_record(tmp_path, weights, monkeypatch):
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=2.0))
    out, again = tmp_path / "out", tmp_path / "again"
    assert main(parse(["modes", "--weights", weights, "--disturbance", "none", "--out", str(out)])) == 0
    found = json.loads((out / "modes.json").read_text())
    assert found["runs"] == 1
    assert found["final_modes"]["return"] == 1  # the detector notices everything
    assert (out / "modes.png").is_file()
    assert main(parse(["modes", "--records", str(out), "--out", str(again)])) == 0
    assert json.loads((again / "modes.json").read_text())["sequences"] == found["sequences"]


def test_linearize_compares_policies(tmp_path, weights):
    policy, out = f"{weights}/lstm.onnx", tmp_path / "out"
    asked = ["--policies", policy, "--encoder", f"{weights}/encoder.onnx", "--samples", "1", "--out", str(out)]
    assert main(parse(["linearize", *asked])) in (0, 1)
    found = json.loads((out / "linearize.json").read_text())
    assert [case["subtask"] for case in found["cases"]] == [1, 2]
    assert found["spectral_radius"] == max(case["spectral_radius"] for case in found["cases"])
    assert found["jacobian_error"] < 1e-5
    assert len(found["cases"][0]["eigenvalues"]) == 40
    with pytest.raises(InputError, match="trained with another encoder"):
        main(parse(["linearize", "--policies", policy, "--out", str(out)]))


def test_a_policy_of_another_world_is_not_linearised(tmp_path, weights):
    (tmp_path / "s.yaml").write_text("timing: {period: 0.05}\n")
    asked = ["--policies", f"{weights}/lstm.onnx", "--encoder", f"{weights}/encoder.onnx"]
    with pytest.raises(InputError, match=r"period is 0\.05, the network was trained with 0\.1"):
        main(parse(["linearize", *asked, "--world", str(tmp_path / "s.yaml"), "--out", str(tmp_path)]))


def test_a_detector_that_notices_everything_has_no_guard_to_probe(tmp_path, weights):
    with pytest.raises(InputError, match="is in mode return"):
        main(parse(["guard", "--weights", weights, "--out", str(tmp_path)]))


def test_return_goes_on_after_a_kill(tmp_path, monkeypatch):
    monkeypatch.setattr(return_certificate, "measured_delay_margin", lambda world, expected: expected)
    monkeypatch.setattr(return_certificate, "LEAST_CALIBRATION", {"box": 6, "draws": 2})
    asked = ["return", "--samples", "4", "--draws", "2", "--workers", "0", "--out"]
    code = main(parse([*asked, str(tmp_path / "whole")]))
    assert code in (0, 1)  # so few postures measure no rate
    whole = json.loads((tmp_path / "whole" / "return.json").read_text())
    assert (whole["samples_inside"], whole["failures_inside"], whole["draws"]) == (4, 0, 2)
    assert (tmp_path / "whole" / "return.png").is_file()
    assert not list((tmp_path / "whole").glob("*.jsonl"))
    out, true = tmp_path / "out", return_certificate.trajectories_home

    def killed(world, samples, pool, store, title):
        if title == "proof, box":
            raise KeyboardInterrupt
        return true(world, samples, pool, store, title)

    monkeypatch.setattr(return_certificate, "trajectories_home", killed)
    with pytest.raises(KeyboardInterrupt):
        main(parse([*asked, str(out)]))
    monkeypatch.setattr(return_certificate, "trajectories_home", true)
    kept = out / "return_trajectories.jsonl"
    rows = 1 + 2 + 4 + 6 + 2  # the fingerprint, two episodes and their postures, the box, two episodes
    assert len(kept.read_text().splitlines()) == rows
    (tmp_path / "s.yaml").write_text("regulator: {state_weight: 2.0}\n")
    with pytest.raises(InputError, match=r"return_trajectories\.jsonl was made with another world\.regulator"):
        main(parse([*asked, str(out), "--world", str(tmp_path / "s.yaml")]))
    kept.write_text(kept.read_text() + "nonsense\n")
    with pytest.raises(InputError, match=rf"damaged in line {rows + 1}: delete that line"):
        main(parse([*asked, str(out)]))
    kept.write_text("".join(kept.read_text().splitlines(keepends=True)[:rows]))
    assert main(parse([*asked, str(out)])) == code
    assert json.loads((out / "return.json").read_text()) == whole
