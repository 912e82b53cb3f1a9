"""What runs networks needs none of what trains them: torch, onnx and the rest are hidden here."""

import json
import os
import subprocess
import sys

import pytest

from models.command_line import ROOT
from tests.diagrams.untrained import save_untrained

TRAINING = ("torch", "onnx", "onnxscript", "h5py")
HIDDEN = {"training": TRAINING, "all": (*TRAINING, "pandas", "pyarrow", "scipy", "sklearn", "dask", "optuna")}


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    """By the names in HIDDEN, environments in which the import of what they name fails, in every process."""
    found = {}
    for key, names in HIDDEN.items():
        folder = tmp_path_factory.mktemp(key)
        for name in names:
            text = f'raise ModuleNotFoundError("No module named {name!r}", name="{name}")\n'
            (folder / f"{name}.py").write_text(text)
        found[key] = os.environ | {"PYTHONPATH": f"{folder}:{ROOT}", "OMP_NUM_THREADS": "1"}
    return found


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


def start(folder, surroundings, *words):
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, env=surroundings, capture_output=True, text=True, check=False,
        timeout=600,
    )  # fmt: skip


def test_they_are_hidden(tmp_path, surroundings):
    for name in HIDDEN["all"]:
        assert f"No module named '{name}'" in start(tmp_path, surroundings["all"], "-c", f"import {name}").stderr


def test_the_main_job_runs(tmp_path, surroundings, weights):
    done = start(
        tmp_path, surroundings["all"], ROOT / "diagrams" / "pick_place.py", "--weights", weights,
        "--disturbance", "none", "--json", "o.json",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, "")  # an untrained network picks nothing
    assert json.loads((tmp_path / "o.json").read_text())["failure"] == "false switch"


def test_the_shipped_networks_load(tmp_path, surroundings):
    code = (
        "from diagrams.world.names import WEIGHTS; from models.inference import Decoder, Encoder, Policy\n"
        "import models.files.detectors\n"
        "Encoder(WEIGHTS / 'encoder.onnx'); Decoder(WEIGHTS / 'decoder.onnx'); Policy(WEIGHTS / 'mtrnn-2.onnx')"
    )
    done = start(tmp_path, surroundings["all"], "-c", code)
    assert done.returncode == 0, done.stderr


def test_a_sweep_runs_in_its_workers(tmp_path, surroundings, weights):
    done = start(
        tmp_path, surroundings["training"], ROOT / "diagrams" / "sweep.py", "--weights", weights, "--episodes", "1",
        "--workers", "2", "--until", "switching", "--disturbance", "A", "none",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_what_needs_torch_says_which_extra_brings_it(tmp_path, surroundings, weights):
    done = start(
        tmp_path,
        surroundings["training"],
        ROOT / "diagrams" / "analysis.py",
        "linearize",
        "--policies",
        weights / "lstm.onnx",
    )
    assert (done.returncode, done.stderr) == (2, "error: this needs torch: pip install -e '.[train]'\n")
    done = start(tmp_path, surroundings["training"], "-m", "models.training", "cae", "--data", "d.h5", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.endswith("pip install -e '.[train]'\n")
