"""The closed loop in mode return, and trajectories home that are kept on disk."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool
from diagrams.episodes.store import RowStore
from diagrams.hybrid import return_trajectories
from diagrams.hybrid.return_loop import ReturnLoop
from diagrams.hybrid.return_trajectories import Sample, Trajectory, trajectories_home

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
    rows, broke_off = loop.run(start, CAN, "left")
    assert broke_off is None
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
    rows, broke_off = loop.run(home + 0.05, CAN, "left")
    assert broke_off == "something is non-finite"
    assert rows.shape == (1, 7)
    at_home = np.tile(home, (3, 1))
    assert Trajectory(at_home, None).arrival(home) == 0
    assert Trajectory(np.vstack((home + 0.1, at_home)), None).arrival(home) == 1
    assert Trajectory(at_home, None, broke_off).arrival(home) == -1


def test_trajectories_survive_the_disk_and_are_not_run_again(world, tmp_path, monkeypatch):
    home = world.initial_posture[:7]
    samples = [Sample(home + 0.02 * k, np.array([0.55, 0.0]), "left") for k in range(5)]

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
        assert (one.touches, one.broke_off) == (other.touches, other.broke_off)
