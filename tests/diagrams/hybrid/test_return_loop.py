"""The closed loop in mode return, and trajectories home that are kept on disk."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid import return_trajectories
from diagrams.hybrid.return_loop import GRASPED_GAP, ReturnLoop
from diagrams.hybrid.return_samples import Sample
from diagrams.hybrid.return_trajectories import Trajectory, trajectories_home
from diagrams.world.task import lifted

CAN = np.array([0.5, 0.0])


@pytest.fixture(scope="module")
def loop(world):
    return ReturnLoop(world)


def test_command_of_the_loop_is_the_regulators(loop, world):
    context = loop.diagram.CreateDefaultContext()
    history = loop.diagram.GetSubsystemByName("posture_history")
    posture = world.initial_posture + np.array([0.2, -0.1, 0.0, 0.1, 0.3, -0.2, 0.1, -0.05])
    history.GetMyMutableContextFromRoot(context).SetDiscreteState(0, posture)
    mixer = loop.diagram.GetSubsystemByName("regulated_mixer")
    command = mixer.GetOutputPort("desired_posture").Eval(mixer.GetMyContextFromRoot(context))
    assert command[:7] == pytest.approx((posture - 0.1 * (posture - world.initial_posture))[:7], abs=1e-9)
    assert command[7] == posture[7]  # the fingers keep their command


def test_trajectory_home_is_replayed_bit_by_bit(loop, world):
    start = world.initial_posture[:7] + 0.05
    rows, slip, broke_off = loop.run(start, CAN, "left")
    assert (slip, broke_off) == (None, None)
    assert np.array_equal(rows, loop.run(start, CAN, "left")[0])
    assert np.array_equal(rows[0], start)
    assert np.abs(rows[-1] - world.initial_posture[:7]).max() < np.deg2rad(3.0)


def test_a_simulation_that_breaks_off_did_not_arrive(loop, world, monkeypatch):
    def breaks(time):
        raise RuntimeError("something is\nnon-finite")

    monkeypatch.setattr(loop, "simulator", SimpleNamespace(
        reset_context=loop.simulator.reset_context, get_mutable_context=loop.simulator.get_mutable_context,
        Initialize=loop.simulator.Initialize, AdvanceTo=breaks,
    ))  # fmt: skip
    home = world.initial_posture[:7]
    rows, _, broke_off = loop.run(home + 0.05, CAN, "left")
    assert broke_off == "something is non-finite"
    assert rows.shape == (1, 7)
    at_home = np.tile(home, (3, 1))
    assert Trajectory(at_home, 0.01, None).arrival(home) == 0
    assert Trajectory(np.vstack((home + 0.1, at_home)), 0.01, None).arrival(home) == 1
    assert Trajectory(at_home, 0.01, None, None, broke_off).arrival(home) == -1


def test_the_first_step_is_the_regulators(loop, world):
    """The command before the first tick is the posture itself, not the initial one."""
    start = world.initial_posture[:7] + np.array([0.5, 0.3, 0.5, -0.5, 0.5, -0.5, 0.5])
    rows, *_ = loop.run(start, CAN, "left")
    step = (rows[1] - rows[0]) / (rows[0] - world.initial_posture[:7])
    assert step == pytest.approx(-0.095, abs=0.012)  # nine tenths of 0.1 at least


def test_a_held_can_comes_home_in_the_hand(loop, world):
    start = world.initial_posture[:7] + np.array([0.4, 0.1, 0.2, -0.2, 0.0, -0.1, 0.2])
    rows, slip, broke_off = loop.run(start, CAN, "left", held=True)
    assert broke_off is None
    assert slip < 0.005
    assert Trajectory(rows, 0.01, None, slip).arrival(world.initial_posture[:7]) > 0
    context = loop.simulator.get_context()
    poses = loop.station.GetOutputPort("can_poses").Eval(loop.station.GetMyContextFromRoot(context))
    assert lifted(poses)
    assert loop.station.finger_gap(context) == pytest.approx(GRASPED_GAP, abs=0.001)
    posture = loop.station.GetOutputPort("posture").Eval(loop.station.GetMyContextFromRoot(context))
    assert posture[7] == world.closed_opening
    # The next one has the can on the desk again, and open fingers.
    assert loop.run(start, CAN, "left")[1] is None
    assert loop.station.finger_gap(loop.simulator.get_context()) == pytest.approx(world.opening, abs=0.001)


def test_what_slipped_far_is_dropped():
    rows = np.zeros((1, 7))
    dropped = [Trajectory(rows, 0.01, None, slip).dropped for slip in (None, 0.01, 0.06)]
    assert dropped == [False, False, True]


def test_trajectories_survive_the_disk_and_are_not_run_again(world, tmp_path, monkeypatch):
    home = world.initial_posture[:7]
    samples = [Sample(tuple((home + 0.02 * k).tolist()), (0.55, 0.0), "left", k == 4) for k in range(5)]

    def run():
        with RowStore(tmp_path / "t.jsonl", fingerprint(world)) as store, Pool(0) as pool:
            return trajectories_home(world, samples, pool, store, "trajectories")

    first = run()
    lines = (tmp_path / "t.jsonl").read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 5
    (tmp_path / "t.jsonl").write_bytes(b"".join(lines[:4]) + lines[4][:20])  # the kill came in the middle of a line
    ran, true = [], return_trajectories.run_job
    monkeypatch.setattr(return_trajectories, "run_job", lambda job: ran.append(job) or true(job))
    again = run()
    assert [sample for _, sample in ran] == samples[3:]
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one.rows, other.rows)
        assert replace(one, rows=None) == replace(other, rows=None)
