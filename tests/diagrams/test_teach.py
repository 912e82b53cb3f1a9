"""The teacher: what lies in the file, and that a killed recording goes on to the same content."""

import json
import signal
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path

import h5py
import numpy as np
import pytest

from diagrams import teach
from diagrams.teach import TeachArguments, Teacher, lessons
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import CAN_HALF_HEIGHT, SPOTS
from diagrams.world.trajectory import DWELL_DEVIATION, FREE_DEVIATION, SUBTASK_STEPS, deviations, subtask_waypoints
from models.command_line import ROOT
from models.data.demonstrations import read_demonstrations, read_header, subtask_ranges
from models.errors import InputError

TICKS = sum(SUBTASK_STEPS)


class InlineExecutor:
    """ProcessPoolExecutor without processes."""

    def __init__(self, workers, mp_context):
        pass

    def shutdown(self, cancel_futures):
        pass

    def submit(self, function, *arguments):
        future = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


class FakeTeacher:
    """Gives lessons without physics; `broken` names one that goes wrong, `killed` one at which the process dies."""

    broken: int | None = None
    killed: int | None = None

    def __init__(self, world):
        self.world = world

    def give(self, lesson):
        if lesson.index == self.killed:
            signal.raise_signal(signal.SIGKILL)
        rng = np.random.default_rng(lesson.index)
        return {
            "rgb": rng.integers(0, 255, (40, 112, 112, 3), np.uint8),
            "posture": rng.normal(size=(40, 8)) + lesson.turn,
            "actions": rng.normal(size=(40, 8)),
            "can_xy": self.world.grid.position(*lesson.grid_index),
            # Nothing that HDF5 can store: the write fails half-way.
            "success": {} if lesson.index == self.broken else True,
        }


@pytest.fixture
def fake(monkeypatch):
    monkeypatch.setattr(teach, "ProcessPoolExecutor", InlineExecutor)
    monkeypatch.setattr(teach, "Teacher", FakeTeacher)
    monkeypatch.setattr(teach, "_teacher", None)


def stored_hash(path):
    with h5py.File(path) as file:
        return file["data"].attrs["content_hash"]


@pytest.fixture
def whole(fake, tmp_path):
    """Hash of five demonstrations recorded without a break."""
    path = tmp_path / "whole.h5"
    assert teach.main(TeachArguments(path, limit=5)) == 0
    return stored_hash(path)


def test_lessons_are_all_positions_times_both_spots(world):
    given = lessons(world, 0)
    assert len(given) == 200
    assert len({(lesson.grid_index, lesson.vacant) for lesson in given}) == 200
    assert sum(lesson.training for lesson in given) == 100
    # One position is wholly in one split.
    assert len({(lesson.grid_index, lesson.training) for lesson in given}) == 100
    assert lessons(world, 0) == given
    assert [lesson.turn for lesson in lessons(world, 1)] != [lesson.turn for lesson in given]


def test_another_run_adds_what_is_missing(whole, tmp_path):
    path = tmp_path / "parts.h5"
    for limit in (1, 3, 5, 5):
        assert teach.main(TeachArguments(path, limit=limit)) == 0
    assert stored_hash(path) == whole


def test_a_write_that_breaks_off_is_done_again(whole, tmp_path, monkeypatch):
    path = tmp_path / "broken.h5"
    monkeypatch.setattr(FakeTeacher, "broken", 2)
    with pytest.raises(TypeError):
        teach.main(TeachArguments(path, limit=5))
    with h5py.File(path) as file:
        assert "demo_2" not in file["data"]
    monkeypatch.setattr(FakeTeacher, "broken", None)
    assert teach.main(TeachArguments(path, limit=5)) == 0
    assert stored_hash(path) == whole
    with h5py.File(path) as file:
        assert set(file) == {"data", "mask"}


def test_a_killed_run_goes_on(whole, tmp_path):
    path = tmp_path / "killed.h5"
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
import test_teach as t
t.teach.ProcessPoolExecutor, t.teach.Teacher = t.InlineExecutor, t.FakeTeacher
t.teach.as_completed = lambda futures: futures
t.InlineExecutor.submit = lambda self, f, *a: Lazy(f, a)
class Lazy:
    def __init__(self, f, a): self.f, self.a = f, a
    def result(self): return self.f(*self.a)
t.FakeTeacher.killed = 3
t.teach.main(t.TeachArguments(Path({str(path)!r}), limit=5))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    with h5py.File(path) as file:
        assert sorted(file["data"]) == ["demo_0", "demo_1", "demo_2"]
    assert teach.main(TeachArguments(path, limit=5)) == 0
    assert stored_hash(path) == whole


def test_a_broken_file_is_named(tmp_path):
    path = tmp_path / "broken.h5"
    path.write_bytes(b"no HDF5")
    with pytest.raises(InputError, match=r"broken\.h5 cannot be opened as HDF5"):
        teach.main(TeachArguments(path, limit=1))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": -1}, "--seed -1 is too small: choose 0 or more"),
        ({"workers": 0}, "--workers 0 is too small: choose 1 or more"),
        ({"limit": -1}, "--limit -1 is too small: choose 1 or more"),
        ({"out": Path("/dev/null/y.h5")}, r"/dev/null/y\.h5 cannot be written"),
    ],
)
def test_bad_input_is_named(tmp_path, changes, named):
    with pytest.raises(InputError, match=named):
        teach.main(TeachArguments(**({"out": tmp_path / "y.h5"} | changes)))


def test_an_error_of_a_process_is_the_program_s(tmp_path, monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json")
    with pytest.raises(InputError, match="EGL is not usable here"):
        teach.main(TeachArguments(tmp_path / "y.h5", workers=1, limit=2))


def test_another_seed_is_refused(fake, tmp_path):
    path = tmp_path / "seed.h5"
    teach.main(TeachArguments(path, limit=1))
    with pytest.raises(InputError, match="another seed or another world"):
        teach.main(TeachArguments(path, limit=1, seed=1))


def test_another_seed_is_another_content(whole, fake, tmp_path):
    path = tmp_path / "other.h5"
    teach.main(TeachArguments(path, limit=5, seed=1))
    assert stored_hash(path) != whole


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
        assert json.loads(data.attrs["env_args"])["seed"] == data.attrs["seed"] == 0
        assert data.attrs["initial_posture"] == pytest.approx(World().initial_posture)
        assert data.attrs["period"] == 0.1
        assert json.loads(data.attrs["posture_names"]) == [*(f"joint_{j}" for j in range(1, 8)), "opening"]
        assert data.attrs["content_hash"] == teach.content_hash(file)
        assert list(file["mask/train"]) == [b"demo_0", b"demo_1"]
        assert len(file["mask/valid"]) == 0
        for index, name in enumerate(("demo_0", "demo_1")):
            demo = data[name]
            assert demo["obs/rgb"].shape == (TICKS, 112, 112, 3)
            assert demo["obs/rgb"].dtype == np.uint8
            assert demo["obs/rgb"].compression == "gzip"
            assert demo["obs/posture"].shape == demo["actions"].shape == (TICKS, 8)
            attributes = dict(demo.attrs)
            assert attributes["num_samples"] == TICKS
            assert attributes["can_xy"] == pytest.approx(World().grid.position(0, 0))
            assert attributes["vacant"] == SPOTS[index]
            assert list(attributes["grid_index"]) == [0, 0]
            assert list(attributes["subtask_starts"]) == [0, SUBTASK_STEPS[0]]
            assert (attributes["split"], attributes["success"]) == ("train", True)


def test_postures_follow_the_actions(recorded):
    with h5py.File(recorded) as file:
        posture, actions = file["data/demo_0/obs/posture"][()], file["data/demo_0/actions"][()]
    assert posture[0] == pytest.approx(World().initial_posture, abs=1e-6)
    off = np.abs(posture[1:, :7] - actions[:-1, :7]).max(axis=1)  # what the arm was pushed off by, and the servo's lag
    assert np.deg2rad(1.0) < off.max() < np.deg2rad(4.0)
    assert off[[*range(76, 98), *range(161 + 105, 161 + 135)]].max() < np.deg2rad(1.0)  # a finger's breadth from a can
    assert np.array_equal(posture[1:, 7], actions[:-1, 7])  # the opening is the commanded one


def test_deviations_are_smooth_bounded_and_none_at_the_cans(world):
    hand = HandKinematics(world.initial_posture[:7])
    for subtask, steps in enumerate(SUBTASK_STEPS, start=1):
        way = subtask_waypoints(world, hand, np.array([*world.grid.position(4, 5), CAN_HALF_HEIGHT]), subtask)
        near, far = way[2].tick, way[-3].tick
        rows = np.array([deviations(way, steps, np.random.default_rng([0, n])) for n in range(20)])
        assert np.array_equal(rows[3], deviations(way, steps, np.random.default_rng([0, 3])))
        assert not np.array_equal(rows[3], rows[4])
        size = np.abs(rows[..., :7]).max(axis=(0, 2))
        assert size.max() <= FREE_DEVIATION
        assert size.max() > 0.9 * FREE_DEVIATION
        assert size[near - 1 : far].max() == 0.0
        assert max(size[: way[1].tick].max(), size[way[-2].tick :].max()) <= DWELL_DEVIATION + 1e-12
        assert not rows[..., 7].any()
        assert np.abs(np.diff(rows, axis=1)).max() < np.deg2rad(1.0)  # a tick


def test_models_read_it(recorded):
    header = read_header(recorded)
    assert (header.total, header.period) == (2 * TICKS, 0.1)
    for demo in read_demonstrations(recorded, "train"):
        first, second = subtask_ranges(demo)
        assert 0 < first[0] < first[1] <= SUBTASK_STEPS[0] <= second[0] < second[1] <= TICKS


def test_another_process_gives_the_same_lesson_bit_by_bit(recorded, world):
    demo = Teacher(world).give(lessons(world, 0)[1])
    assert demo["success"]
    assert demo["margin_deg"] >= 8.0
    with h5py.File(recorded) as file:
        for key, name in (("rgb", "obs/rgb"), ("posture", "obs/posture"), ("actions", "actions")):
            assert np.array_equal(file["data/demo_1"][name][()], demo[key])
