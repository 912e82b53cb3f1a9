"""The program as a user starts it.

Exit codes, one clear line for bad input, options over YAML, what it leaves behind.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from diagrams import pick_place
from diagrams.episodes.tick_table import PARTS
from diagrams.pick_place import parse
from diagrams.world.names import WEIGHTS
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.untrained import save_untrained

PROGRAM = ROOT / "diagrams" / "pick_place.py"
FIELDS = {  # of --json
    "seed", "rnn", "detector", "disturbance", "can_xy", "vacant", "picked", "placed", "home", "success", "switched",
    "detection_delay_s", "false_switches", "returned", "resumed", "switch_success", "alpha_max_before", "sim_seconds",
    "wall_seconds", "realtime_factor", "weights_hash",
}  # fmt: skip


def start(folder, *arguments, env=None):
    """Runs the program in `folder`."""
    return subprocess.run(
        [sys.executable, str(PROGRAM), *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False,
        timeout=600, env=env,
    )  # fmt: skip


def assert_bad_input(done, *named):
    assert done.returncode == 2, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    for text in named:
        assert text in lines[0]


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--seed", "-1"), ["seed -1 is negative"]),
        (("--realtime-rate", "nan"), ["real-time rate nan is negative or not finite"]),
        (("--rnn", "perceptron"), ["no network 'perceptron'", "choose from", "lstm"]),
        (("--disturbance", "C"), ["no disturbance 'C'", "none, A, B"]),
        (("--disturbance", "camera_shift", "--severity", "2"), ["severity 2.0 is out of range", "from 0 to 1"]),
        (("--severity", "0.5"), ["severity 0.5 says nothing to the disturbance 'A'", "leave it out"]),
        (("--replay", "replay.htm"), ["replay.htm", ".html"]),
        (("--vacant", "middle"), ["no vacant spot 'middle'", "left, right"]),
        (("--can", "0.9", "0.0"), ["(0.900, 0.000) m is out of reach", "x in [0.43, 0.63]"]),
        (("--can", "0.5"), ["does not have two numbers"]),
        (("--graphviz", "diagram.gif"), ["diagram.gif", ".dot, .svg, .png"]),
        (("--plot", "timeline.doc"), ["timeline.doc", ".png, .svg, .pdf"]),
        (("--plot", "x.png", "--graphviz", "x.png"), ["--graphviz x.png is the file of --plot too"]),
        (("--rnn", "lstm", "--policy", "json:loads"), ["--rnn and --policy are given: leave one out"]),
        (("--seed", "x"), ["--seed: invalid literal", "--help"]),
        (("--seeds", "1"), ["Unrecognized options: --seeds"]),
        (("--json", "/dev/null/outcome.json"), ["/dev/null/outcome.json cannot be written"]),
        (("--recovery", "panic"), ["there is no recovery 'panic'", "choose from planned, backoff"]),
        (("--record", "run.csv"), ["run.csv", ".npz"]),
        (("--mcap", "run.bag"), ["run.bag", ".mcap"]),
        (("--mcap", "/dev/null/run.mcap"), ["/dev/null/run.mcap cannot be written"]),
        (
            ("--weights", "nowhere"),
            ["no network 'lstm' in nowhere", "another folder", "python -m models.training"],
        ),
    ],
)
def test_bad_input_is_one_clear_line(tmp_path, arguments, named):
    assert_bad_input(start(tmp_path, *arguments), *named)


def test_unknown_key_of_a_scenario_is_one_clear_line(tmp_path):
    (tmp_path / "scenario.yaml").write_text("world:\n  grid: {spacings: 0.1}\n")
    assert_bad_input(start(tmp_path, "--scenario", "scenario.yaml"), "scenario.yaml", "spacings")


def test_damaged_weights_are_one_clear_line(tmp_path, untrained):
    whole = (untrained / "lstm.onnx").read_bytes()
    (tmp_path / "encoder.onnx").symlink_to(untrained / "encoder.onnx")
    (tmp_path / "lstm.onnx").write_bytes(whole[: len(whole) // 2])
    assert_bad_input(start(tmp_path, "--weights", tmp_path), "lstm.onnx", "damaged")


# In this process, for speed; __main__ turns these errors into the line and the code 2.


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"encoder_hash": "0" * 64}, "the policy was trained with 0000"),
        ({"calibrated": False}, "no calibration"),
    ],
)
def test_weights_that_do_not_fit_together_are_bad_input(tmp_path, monkeypatch, changes, named):
    monkeypatch.chdir(tmp_path)
    folder = save_untrained(tmp_path / "weights", **changes)
    with pytest.raises(InputError, match=named):
        pick_place.main(parse(["--weights", str(folder)]))
    assert list(tmp_path.iterdir()) == [folder]  # no empty outputs


def test_the_file_is_told_whose_value_is_refused_later(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, wrong in (
        ("disturbance: {kind: A, severity: 0.5}", "the severity 0.5 says nothing"),
        ("disturbance: {kind: A, level: 0.2, hold_ticks: 2, target: [0, 0, 0, -3, 0, 0, 0]}", "outside of the joint"),
    ):
        (tmp_path / "s.yaml").write_text(text)
        with pytest.raises(InputError, match=wrong) as refused:
            pick_place.main(parse(["--scenario", "s.yaml"]))
        assert refused.value.__notes__ == ["the scenario file is s.yaml"]


def test_defaults():
    cli = parse([])
    assert (cli.rnn, cli.disturbance.kind, cli.seed, cli.can, cli.vacant) == ("lstm", "A", 0, None, None)
    assert (cli.video, cli.json, cli.record, cli.meshcat, cli.realtime_rate) == (None, None, None, False, 0.0)
    assert {path.parent.name for path in (cli.graphviz, cli.replay, cli.plot)} == {"outputs"}
    assert cli.graphviz.suffix == ".svg"


def test_options_go_over_the_file_and_the_file_over_the_defaults(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "seed: 7\nvacant: right\ncan: [0.5, 0.02]\ndisturbance: {kind: B, level: 0.1, hold_ticks: 20}\n"
        "world:\n  regulator: {state_weight: 2.0}\n"
    )
    cli = parse(
        ["--scenario", str(path), "--seed", "8", "--world.regulator.input-weight", "180", "--disturbance.level", "0.2"]
    )
    assert (cli.seed, cli.vacant, list(cli.can)) == (8, "right", [0.5, 0.02])
    assert (cli.disturbance.kind, cli.disturbance.level, cli.disturbance.hold_ticks) == ("B", 0.2, 20)
    assert (cli.world.regulator.state_weight, cli.world.regulator.input_weight) == (2.0, 180.0)
    assert cli.world.timing.period == 0.1


def test_options():
    words = """--rnn gru --disturbance B --seed 3 --can 0.5 0.01 --vacant left --graphviz g.dot --video v.mp4 --meshcat
        --replay r.html --record r.npz --plot p.png --realtime-rate 1.0 --json o.json --profile"""
    cli = parse(words.split())
    assert (cli.rnn, cli.disturbance.kind, cli.seed, list(cli.can), cli.vacant) == ("gru", "B", 3, [0.5, 0.01], "left")
    assert [str(p) for p in (cli.graphviz, cli.video, cli.replay, cli.record, cli.plot, cli.json)] == [
        "g.dot", "v.mp4", "r.html", "r.npz", "p.png", "o.json",
    ]  # fmt: skip
    assert (cli.meshcat, cli.realtime_rate, cli.profile) == (True, 1.0, True)


def test_a_fault_and_its_severity_by_options_and_by_file(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("disturbance: {kind: camera_shift, severity: 0.25, level: 0.1}\n")
    assert parse(["--disturbance", "payload", "--severity", "0.5"]).disturbance.severity == 0.5
    for words, severity in ((), 0.25), (("--severity", "0.75"), 0.75):
        given = parse(["--scenario", str(path), *words]).disturbance
        assert (given.kind, given.severity, given.level) == ("camera_shift", severity, 0.1)


def test_words_come_before_what_takes_long_to_load():
    slow = ("onnxruntime", "torch", "matplotlib", "scipy", "cv2", "pydrake.geometry", "pydrake.multibody.plant")
    code = f"import sys, diagrams.pick_place; print([name for name in {slow} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_help_into_a_closed_pipe_ends_quietly():
    done = subprocess.run(
        f"{sys.executable} {PROGRAM} --help | head -n 1", shell=True, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "usage" in done.stdout


def test_a_picture_that_cannot_be_drawn_does_not_undo_the_episode(tmp_path, untrained):
    """A `dot` that fails, and a backend of matplotlib that is not there."""
    dot = tmp_path / "bin" / "dot"
    dot.parent.mkdir()
    dot.write_text("#!/bin/sh\nexit 1\n")
    dot.chmod(0o755)
    surroundings = os.environ | {"PATH": f"{dot.parent}:{os.environ['PATH']}", "MPLBACKEND": "module://nowhere"}
    done = start(tmp_path, "--weights", untrained, "--disturbance", "none", "--json", "o.json", env=surroundings)
    assert done.returncode == 1, done.stderr
    assert json.loads((tmp_path / "o.json").read_text())["failure"] == "false switch"
    assert "Traceback" not in done.stderr
    assert "warning: the diagram could not be drawn" in done.stderr


def test_failed_task_has_code_1_and_a_whole_summary(tmp_path, untrained):
    """Networks that learned nothing: the detector notices at once, the arm stays at home for a minute."""
    done = start(tmp_path, "--weights", untrained, "--disturbance", "none", "--json", "new/outcome.json")
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    outcome = json.loads((tmp_path / "new" / "outcome.json").read_text())
    assert set(outcome) >= FIELDS
    assert (outcome["success"], outcome["picked"], outcome["switched"], outcome["home"]) == (False, False, True, True)
    assert (outcome["failure"], outcome["sim_seconds"]) == ("false switch", 60.0)
    assert "task failed (false switch): picked no, placed no, at the initial posture yes" in done.stdout
    assert "59.9 s  time is up" in done.stdout  # the last tick
    for name in ("replay.html", "timeline.png", "diagram.svg"):
        assert (tmp_path / "outputs" / name).is_file()


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """The program on the shipped weights, then once more with its profile, at 50 times real time, too fast to be kept.

    (folder, what it printed) of each.
    """
    for name in ("encoder", "lstm"):
        path = WEIGHTS / f"{name}.onnx"
        assert path.is_file(), (
            f"{path} is not there: the weights belong to the repository (see the README for training)"
        )
    runs = []
    for options in ((), ("--profile", "--realtime-rate", "50")):
        folder = tmp_path_factory.mktemp("run")
        runs.append((folder, start(folder, "--json", "outputs/outcome.json", *options)))
    return runs


def outcome_of(run):
    return json.loads((run[0] / "outputs" / "outcome.json").read_text())


def test_undisturbed_task_is_done(tmp_path):
    done = start(tmp_path, "--disturbance", "none")
    assert done.returncode == 0, done.stdout + done.stderr
    for words in ("subtask 1", "picked; subtask 2", "placed", "task done"):
        assert words in done.stdout


def test_main_job_is_done(shipped):
    _, done = shipped[0]
    assert done.returncode == 0, done.stdout + done.stderr
    for words in (
        "subtask 1", "disturbs the arm", "switched to the LQR", "at the initial posture", "the network resumes",
        "placed",
        "task done", "switching as it should",
    ):  # fmt: skip
        assert words in done.stdout


def test_outcome_of_the_default_run(shipped):
    outcome = outcome_of(shipped[0])
    assert set(outcome) >= FIELDS
    assert (outcome["seed"], outcome["rnn"], outcome["detector"], outcome["disturbance"]) == (0, "lstm", "recall", "A")
    flags = ("picked", "placed", "home", "success", "switched", "returned", "resumed", "switch_success")
    assert all(outcome[name] is True for name in flags)
    assert len(outcome["can_xy"]) == 2
    assert outcome["vacant"] in ("left", "right")
    assert outcome["false_switches"] == 0
    assert 0.0 <= outcome["detection_delay_s"] < 3.0
    assert 0.0 <= outcome["alpha_max_before"] < 0.5
    assert len(outcome["weights_hash"]) == 64
    assert outcome["sim_seconds"] / outcome["wall_seconds"] == pytest.approx(outcome["realtime_factor"])


def test_pictures_are_there(shipped):
    outputs = shipped[0][0] / "outputs"
    picture = cv2.imread(str(outputs / "timeline.png"))
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100  # curves in many colours
    assert "switched_controller" in (outputs / "diagram.svg").read_text()
    page = (outputs / "replay.html").read_text()
    assert page.lstrip().startswith("<!DOCTYPE html>")
    assert '<script src="http' not in page  # it opens offline


def test_the_profile_is_printed_where_asked_for(shipped):
    (_, plain), (_, profiled) = shipped
    rows = re.findall(r"^(\w[\w ]*\w) +(\d+\.\d\d) ms +(\d+)%$", profiled.stdout, re.MULTILINE)
    assert [row[0] for row in rows] == [*PARTS, "tick"]
    assert sum(float(row[1]) for row in rows[:-1]) == pytest.approx(float(rows[-1][1]), abs=0.04)
    assert rows[-1][2] == "100"
    assert "rendering" not in plain.stdout


def test_what_the_ticks_took_is_told_where_they_keep_to_the_clock(shipped):
    (_, plain), (_, timed) = shipped
    words = r"^(\d+) of (\d+) ticks late \(over 2 ms\); a tick takes ([\d.]+) ms in the median, ([\d.]+) ms at 99 %, "
    late, ticks, median, most, largest = map(
        float, re.search(words + r"([\d.]+) ms at most$", timed.stdout, re.M).groups()
    )
    assert 0.5 * ticks < late <= ticks
    assert 2.0 < median <= most <= largest
    assert "ticks late" not in plain.stdout
    assert "requirements broken" not in plain.stdout


def test_second_run_is_the_same(shipped):
    first, second = (outcome_of(run) for run in shipped)
    for name in ("wall_seconds", "realtime_factor"):
        first.pop(name)
        second.pop(name)
    assert first == second


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, a disk without room")
def test_a_full_disk_costs_that_file_alone(tmp_path, untrained):
    (tmp_path / "o.json").symlink_to("/dev/full")
    done = start(
        tmp_path, "--weights", untrained, "--disturbance", "none", "--json", "o.json", "--record", "o.npz", "--mcap",
        "o.mcap",
    )  # fmt: skip
    assert done.returncode == 2
    assert (
        "error: o.json cannot be written (No space left on device): make room there, or choose another place"
        in done.stderr
    )
    assert "Traceback" not in done.stderr
    assert "task failed" in done.stdout
    assert all((tmp_path / name).stat().st_size for name in ("o.npz", "o.mcap"))
