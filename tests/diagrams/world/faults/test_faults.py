"""Every fault of the registry in the closed loop: nothing at severity 0, something at severity 1."""

import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import FROM_START
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS

CAN, VACANT = (0.555, -0.041), "left"
SECONDS = 2.0


def given_in_full(kind, severity, world):
    """The fault from the first tick on."""
    fault = FAULTS[kind]
    given = DisturbanceSpec(kind, FROM_START, subtask=fault.subtask or 1, severity=severity)
    given.hold_ticks = 0 if fault.lasts else 10
    given.target = [*world.initial_posture[:-1] + 0.3] * fault.targets or None
    if getattr(fault, "moved_by", None):
        given.can_moved_to = [0.33, 0.387] if fault.moves else [0.6, 0.0]
    given.check()
    return given


def run(rollout, policy, given):
    episode = Episode(5, CAN, VACANT, given)
    policy.learn(Episode(5, CAN, VACANT))
    outcome, record = rollout.run(episode, time_limit=SECONDS, picture_every=1)
    return outcome, record


@pytest.fixture(scope="module")
def without(rollout, policy):
    return run(rollout, policy, DisturbanceSpec())


@pytest.mark.parametrize("kind", FAULTS)
def test_severity_0_changes_no_bit_and_severity_1_does(kind, world, encoder, policy, without):
    rollout = Rollout(world, encoder, policy, fault=kind)
    outcome, record = run(rollout, policy, given_in_full(kind, 0.0, world))
    assert record_hash(record) == record_hash(without[1])
    assert record.pictures.tobytes() == without[1].pictures.tobytes()
    assert record.events == without[1].events
    assert (outcome.severity, outcome.void) == (0.0, False)
    _, undisturbed = run(rollout, policy, DisturbanceSpec())
    assert record_hash(undisturbed) == record_hash(without[1])
    outcome, record = run(rollout, policy, given_in_full(kind, 1.0, world))
    changed = record_hash(record) != record_hash(without[1])
    assert changed or record.pictures.tobytes() != without[1].pictures.tobytes()
    assert (outcome.disturbance, outcome.severity, outcome.void) == (kind, 1.0, False)
    assert f"{kind} begins" in [what for _, what in record.events]
