"""The program: what it records, what it keeps in memory, and that a killed recording goes on to the same content."""

import json
import signal
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from diagrams import teach
from diagrams.teach import TeachArguments
from diagrams.world.configuration import World
from diagrams.world.names import SPOTS
from diagrams.world.teacher import Teacher, setups
from diagrams.world.trajectory import SUBTASK_STEPS
from models.command_line import ROOT
from models.data.demonstrations import read_demonstrations, read_header, subtask_ranges
from models.data.recording import RecordingFile, content_hash
from models.errors import InputError
from tests.diagrams import teacher_fakes

TICKS = sum(SUBTASK_STEPS)


@pytest.fixture
def fake(monkeypatch):
    monkeypatch.setattr(teach, "demonstrate", teacher_fakes.demonstrate)


def arguments(path, **changes):
    """Without worker processes."""
    return replace(TeachArguments(path, workers=0, limit=5), **changes)


@pytest.fixture
def whole(fake, tmp_path):
    """Hash of five demonstrations recorded without a break."""
    assert teach.main(arguments(tmp_path / "whole.h5")) == 0
    return read_header(tmp_path / "whole.h5").content_hash


def test_another_run_adds_what_is_missing(whole, tmp_path, capsys):
    path = tmp_path / "parts.h5"
    for limit in (1, 3, 5, 5):
        assert teach.main(arguments(path, limit=limit)) == 0
    assert read_header(path).content_hash == whole
    assert f"5 of 5 demonstrations succeeded; content {whole[:16]}" in capsys.readouterr().out


def test_a_killed_run_goes_on(whole, tmp_path):
    path = tmp_path / "killed.h5"
    code = f"""
import signal
from pathlib import Path
from diagrams import teach
from tests.diagrams import teacher_fakes

def demonstrate(job):
    if job[1].name == "demo_3":
        signal.raise_signal(signal.SIGKILL)
    return teacher_fakes.demonstrate(job)

teach.demonstrate = demonstrate
teach.main(teach.TeachArguments(Path({str(path)!r}), workers=0, limit=5))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    with h5py.File(path) as file:
        assert sorted(file["data"]) == ["demo_0", "demo_1", "demo_2"]
    assert teach.main(arguments(path)) == 0
    assert read_header(path).content_hash == whole


def test_lerobots_layout(fake, tmp_path, capsys):
    path = tmp_path / "lerobot"
    for limit in (2, 5):
        assert teach.main(arguments(path, format="lerobot", limit=limit)) == 0
    assert "5 of 5 demonstrations succeeded" in capsys.readouterr().out
    info = json.loads((path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (5, 5 * 40, 10)
    assert info["features"]["observation.state"]["names"] == [*(f"joint_{j}" for j in range(1, 8)), "opening"]
    with pytest.raises(InputError, match="recorded with another seed"):
        teach.main(arguments(path, format="lerobot", seed=1))


@pytest.mark.parametrize("workers", [0, 1])
def test_pictures_are_not_kept_in_memory(fake, tmp_path, monkeypatch, workers):
    written, alive = [], []

    def add(file, recording):
        written.append(weakref.ref(recording))
        alive.append(sum(kept() is not None for kept in written))

    monkeypatch.setattr(RecordingFile, "add", add)
    monkeypatch.setattr(RecordingFile, "finish", lambda *_: ("", []))
    teach.main(arguments(tmp_path / "y.h5", workers=workers, limit=10))
    assert len(alive) == 10
    assert max(alive) <= 2  # the one that is written, and the one that the loop still names


def test_a_demonstration_that_fails_is_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(teach, "demonstrate", lambda job: teacher_fakes.recording(int(job[1].name[5:]), success=False))
    assert teach.main(arguments(tmp_path / "y.h5", limit=2)) == 1
    said = capsys.readouterr()
    assert "0 of 2 demonstrations succeeded" in said.out
    assert "failed: demo_0, demo_1" in said.err


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": -1}, "--seed -1 is too small: choose 0 or more"),
        ({"workers": -1}, "--workers -1 is too small: choose 0 or more"),
        ({"limit": 0}, "--limit 0 is too small: choose 1 or more"),
        ({"out": Path("/dev/null/y.h5")}, r"/dev/null/y\.h5 cannot be written"),
        ({"world": Path("nowhere.yaml")}, r"no world file nowhere\.yaml"),
    ],
)
def test_bad_input_is_named(tmp_path, changes, named):
    with pytest.raises(InputError, match=named):
        teach.main(arguments(tmp_path / "y.h5", **changes))


def test_an_error_of_a_process_is_the_program_s(tmp_path, monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json")
    with pytest.raises(InputError, match="EGL is not usable here"):
        teach.main(arguments(tmp_path / "y.h5", workers=1, limit=2))


def test_without_h5py_one_line_says_what_to_install(tmp_path):
    code = "import sys; sys.modules['h5py'] = None; from diagrams.teach import *; run(main, parse)"
    done = subprocess.run(
        [sys.executable, "-c", code, "--out", str(tmp_path / "y.h5")], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (2, "error: this needs h5py: pip install -e '.[train]'\n")


def test_another_seed_is_another_content(whole, tmp_path):
    teach.main(arguments(tmp_path / "other.h5", seed=1))
    assert read_header(tmp_path / "other.h5").content_hash != whole


def test_the_world_of_a_file_is_taught(fake, tmp_path):
    world, path = tmp_path / "world.yaml", tmp_path / "y.h5"
    world.write_text("grid: {count: 2}\ntiming: {period: 0.2}\n")
    assert teach.main(arguments(path, world=world, limit=None)) == 0
    with h5py.File(path) as file:
        assert len(file["data"]) == 2 * 2 * 2
        assert file["data"].attrs["period"] == 0.2
    trained = {"models": "pick_place.dmd.yaml", "period": 0.2, "camera": [112, 112, 43.0], "closed_opening": 0.03}
    assert read_header(path).world == trained
    with h5py.File(path) as file:
        assert json.loads(file["data"].attrs["env_args"])["world"]["grid"]["count"] == 2
    with pytest.raises(InputError, match="another world"):
        teach.main(arguments(path))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The real thing: the first position with both spots, in two processes."""
    path = tmp_path_factory.mktemp("teach") / "demonstrations.h5"
    assert teach.main(TeachArguments(path, workers=2, limit=2)) == 0
    return path


def test_layout_is_robomimics(recorded):
    with h5py.File(recorded) as file:
        data = file["data"]
        assert data.attrs["total"] == 2 * TICKS
        assert json.loads(data.attrs["env_args"])["seed"] == 0
        assert data.attrs["initial_posture"] == pytest.approx(World().initial_posture)
        assert data.attrs["period"] == 0.1
        assert json.loads(data.attrs["posture_names"]) == [*(f"joint_{j}" for j in range(1, 8)), "opening"]
        assert data.attrs["content_hash"] == content_hash(file)
        assert list(file["mask/train"]) == [b"demo_0", b"demo_1"]
        assert len(file["mask/valid"]) == 0
        for index, name in enumerate(("demo_0", "demo_1")):
            demo = data[name]
            assert demo["obs/rgb"].shape == (TICKS, 112, 112, 3)
            assert demo["obs/rgb"].dtype == np.uint8
            assert demo["obs/posture"].shape == demo["actions"].shape == (TICKS, 8)
            attributes = dict(demo.attrs)
            assert attributes["num_samples"] == TICKS
            assert attributes["can_xy"] == pytest.approx(World().grid.position(0, 0))
            assert attributes["vacant"] == SPOTS[index]
            assert list(attributes["grid_index"]) == [0, 0]
            assert list(attributes["subtask_starts"]) == [0, SUBTASK_STEPS[0]]
            assert (attributes["split"], attributes["success"]) == ("train", True)


def test_models_read_it(recorded):
    for demo in read_demonstrations(recorded, "train"):
        first, second = subtask_ranges(demo)
        assert 0 < first[0] < first[1] <= SUBTASK_STEPS[0] <= second[0] < second[1] <= TICKS


def test_another_process_gives_the_same_demonstration_bit_by_bit(recorded, world):
    again = Teacher(world).demonstrate(setups(world, 0)[1])
    with h5py.File(recorded) as file:
        for name, array in (("obs/rgb", again.rgb), ("obs/posture", again.posture), ("actions", again.actions)):
            assert np.array_equal(file["data/demo_1"][name][()], array)
