"""The way home in incremental form, in the loop: a joint that is read off its angle does not keep it from home."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.analysis import main, parse
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import Regulator
from diagrams.world.names import ARM_JOINTS
from diagrams.world.task import HOME_TOLERANCE
from models.errors import InputError

SECONDS = 14.0


@pytest.fixture(scope="module")
def incremental(world):
    return replace(world, regulator=Regulator(offset=0.1))


def wires_into(rollout, *names):
    return {
        f"{source.get_name()}.{source.get_output_port(out).get_name()} -> "
        f"{target.get_name()}.{target.get_input_port(into).get_name()}"
        for (target, into), (source, out) in rollout.diagram.connection_map().items()
        if target.get_name() in names
    }


def test_it_stands_between_limit_and_filter_and_goes_on_from_what_that_made(incremental, encoder, policy):
    rollout = Rollout(incremental, encoder, policy)
    assert wires_into(rollout, "incremental_command", "acceleration_limit", "clearance_filter", "disturbance") == {
        "switched_controller.measured_posture -> incremental_command.posture",
        "acceleration_limit.limited_posture -> incremental_command.desired_posture",
        "switched_controller.alpha -> incremental_command.alpha",
        "clearance_filter.filtered_posture -> incremental_command.sent_posture",
        "switched_controller.measured_posture -> acceleration_limit.posture",
        "switched_controller.desired_posture -> acceleration_limit.desired_posture",
        "switched_controller.alpha -> acceleration_limit.alpha",
        "switched_controller.measured_posture -> clearance_filter.posture",
        "incremental_command.incremental_posture -> clearance_filter.desired_posture",
        "switched_controller.alpha -> clearance_filter.alpha",
        "clearance_filter.filtered_posture -> disturbance.desired_posture",
        "station.approach_distance -> disturbance.trigger",
    }


@pytest.mark.parametrize(("recovery", "there"), [("regulator", True), ("hold", False), ("retrace", False)])
def test_it_is_about_the_regulators_steps_alone(incremental, encoder, policy, recovery, there):
    diagram = Rollout(incremental, encoder, policy, recovery=recovery).diagram
    assert diagram.HasSubsystemNamed("incremental_command") is there
    assert diagram.HasSubsystemNamed("acceleration_limit") is there


def test_what_ships_has_none(rollout):
    assert not rollout.diagram.HasSubsystemNamed("incremental_command")


def test_a_joint_that_is_read_off_its_angle_comes_home(world, incremental, encoder, policy, sampler):
    episode = next(e for e in (sampler.sample(s, "joint_offset") for s in range(100)) if e.disturbance.subtask == 1)
    nearest = []
    for given in (world, incremental):
        policy.learn(episode)
        _, record = Rollout(given, encoder, policy, fault="joint_offset").run(episode, time_limit=SECONDS)
        alarm = int(np.argmax(record.alpha >= 0.5))
        assert 0 < alarm < len(record.time) - 60
        off = np.abs(record.posture - world.initial_posture)[:, :ARM_JOINTS].max(axis=1)
        nearest.append(np.rad2deg(off[alarm + 40 :].min()))
    assert nearest[0] > 10.0
    assert nearest[1] < np.rad2deg(HOME_TOLERANCE)


def test_the_certificate_is_not_of_it(tmp_path):
    (tmp_path / "offset.yaml").write_text("{regulator: {offset: 0.1}}")
    with pytest.raises(InputError, match=r"world.regulator.offset 0.1 rad: the certificate is of"):
        main(parse(["return", "--world", str(tmp_path / "offset.yaml"), "--out", str(tmp_path / "out")]))
