"""Every fault of the registry in the closed loop: nothing at severity 0, something at severity 1."""

import numpy as np
import pytest
from pydrake.geometry import Role

from diagrams.episodes.calibration import never_fires
from diagrams.episodes.episode import Episode
from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import FROM_START
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT
from diagrams.world.task import PLACE_TOLERANCE, tilt
from models.errors import InputError
from systems.faults.joint_offset import JointOffset
from systems.oracle_detector import OracleDetector

CAN, VACANT = (0.555, -0.041), "left"
SECONDS = 1.2


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


def run(rollout, policy, given, seconds=SECONDS):
    policy.learn(Episode(5, CAN, VACANT))
    return rollout.run(Episode(5, CAN, VACANT, given), time_limit=seconds, picture_every=1)


@pytest.fixture(scope="module")
def without(rollout, policy):
    return run(rollout, policy, DisturbanceSpec())


@pytest.mark.parametrize("kind", list(FAULTS))
def test_severity_0_changes_no_bit_and_severity_1_does(kind, world, encoder, policy, without):
    rollout, (_, plain) = Rollout(world, encoder, policy, fault=kind), without
    outcome, record = run(rollout, policy, given_in_full(kind, 0.0, world))
    assert record_hash(record) == record_hash(plain)
    assert record.pictures.tobytes() == plain.pictures.tobytes()
    assert record.events == plain.events
    assert (outcome.severity, outcome.void) == (0.0, False)
    outcome, record = run(rollout, policy, given_in_full(kind, 1.0, world))
    changed = record_hash(record) != record_hash(plain) or record.pictures.tobytes() != plain.pictures.tobytes()
    assert changed or kind == "friction"  # nothing is touched yet: see below
    assert (outcome.disturbance, outcome.severity, outcome.void) == (kind, 1.0, False)
    assert f"{kind} begins" in [what for _, what in record.events]


def test_a_diagram_has_the_system_of_its_fault_alone(world, encoder, policy, rollout):
    def names(built):
        return {system.get_name() for system in built.diagram.GetSystems()}

    def extra(kind):
        built = Rollout(world, encoder, policy, fault=kind)
        return names(built) - names(rollout), built

    for kind, more in (("camera_shift", set()), ("push_hand", set()), ("joint_offset", {"true_posture"})):
        found, built = extra(kind)
        assert found == {"fault", *more}
        assert type(built.fault.fault) is FAULTS[kind]
        with pytest.raises(InputError, match=rf"the diagram has the fault '{kind}', not 'payload'"):
            built.create_context(Episode(5, CAN, VACANT, given_in_full("payload", 1.0, world)))
    with pytest.raises(InputError, match="has the fault 'payload', the diagram has none"):
        rollout.create_context(Episode(5, CAN, VACANT, given_in_full("payload", 1.0, world)))


def test_the_can_moved_is_the_disturbance_moved(world, encoder, policy, rollout, sampler):
    one, other = (sampler.sample(11, kind, can_xy=CAN, vacant=VACANT) for kind in ("moved", "can_moved"))
    assert (one.disturbance.level, one.disturbance.can_moved_to) == (
        other.disturbance.level, other.disturbance.can_moved_to,
    )  # fmt: skip
    runs = []
    for built, episode in ((rollout, one), (Rollout(world, encoder, policy, fault="can_moved"), other)):
        policy.learn(Episode(11, CAN, VACANT))
        runs.append(built.run(episode, time_limit=6.0))
    (_, moved), (outcome, record) = runs
    assert record_hash(record) == record_hash(moved)
    off = np.linalg.norm(record.can_poses[:, 4:6] - one.disturbance.can_moved_to, axis=1)
    assert off.min() < 0.001
    assert off[0] > 0.029
    assert not outcome.void


@pytest.mark.parametrize("severity", [0.5, 1.0])
def test_a_can_is_put_the_share_of_the_way(severity, world, encoder, policy):
    built = Rollout(world, encoder, policy, fault="can_moved_far")
    _, record = run(built, policy, given_in_full("can_moved_far", severity, world))
    wanted = np.array(CAN) + severity * (np.array([0.6, 0.0]) - CAN)
    assert record.can_poses[0, 4:7] == pytest.approx([*wanted, CAN_HALF_HEIGHT], abs=0.001)


def test_a_can_that_is_tilted_falls_or_does_not(world, encoder, policy):
    built = Rollout(world, encoder, policy, fault="can_toppled")
    for severity, least, most in ((1.0, 80.0, 100.0), (0.5, 80.0, 100.0), (0.2, 0.0, 3.0)):
        _, record = run(built, policy, given_in_full("can_toppled", severity, world), seconds=2.5)
        degrees = np.rad2deg(tilt(record.can_poses[:, :7]))
        assert degrees[0] == pytest.approx(90.0 * severity, abs=12.0)
        assert least <= degrees[-1] <= most
        assert np.all(record.can_poses[:, 6] > 0.02)


def test_the_other_can_shall_stay_where_it_was_put(world, encoder, policy):
    built = Rollout(world, encoder, policy, fault="neighbour_moved")
    given = given_in_full("neighbour_moved", 1.0, world)
    monitor = built.prepare(Episode(5, CAN, VACANT, given))
    _, record = run(built, policy, given)
    assert monitor.neighbour[:2].tolist() == given.can_moved_to
    assert monitor.neighbour_untouched(record.can_poses[-1])
    plain = built.prepare(Episode(5, CAN, VACANT))
    assert not plain.neighbour_untouched(record.can_poses[-1])
    assert np.linalg.norm(record.can_poses[-1, 11:] - plain.neighbour) < PLACE_TOLERANCE + 0.02


def test_friction_is_that_of_can_and_fingers_alone(world, encoder, policy):
    built = Rollout(world, encoder, policy, fault="friction")
    plant, graph, found = built.station.plant, built.station.scene_graph, {}
    for severity in (0.0, 0.5):
        root = built.create_context(Episode(5, CAN, VACANT, given_in_full("friction", severity, world)))
        inspector = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(root)).inspector()
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            place = plant.GetModelInstanceName(body.model_instance()), body.name(), inspector.GetName(shape)
            properties = inspector.GetProximityProperties(shape)
            found.setdefault(place, []).append(properties.GetProperty("material", "coulomb_friction").static_friction())
    for (model, body, _), (before, after) in found.items():
        slippery = model == "can_to_pick" or body in ("left_finger", "right_finger")
        assert after == pytest.approx(0.55 * before if slippery else before)


def test_the_truth_is_judged_where_a_sensor_is_wrong(world, encoder, policy):
    """The posture of the record is what the controller was told; that of the judgement is as it was."""
    built = Rollout(world, encoder, policy, fault="joint_offset")
    given = given_in_full("joint_offset", 1.0, world)
    _, record = run(built, policy, given)
    off = record.posture[1] - world.initial_posture
    assert np.rad2deg(np.abs(off).max()) == pytest.approx(5.0, abs=0.2)
    true = built.judged("true_posture")
    assert np.rad2deg(np.abs(record.posture[-1] - true).max()) == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize("kind", ["push_hand", "camera_gain"])
def test_a_person_may_have_hands_in_it_too(kind, world, encoder, policy):
    given, hashes = given_in_full(kind, 1.0, world), set()
    for hands in (False, True):
        built = Rollout(world, encoder, policy, hands=hands, fault=kind)
        hashes.add(record_hash(run(built, policy, given)[1]))
        assert built.diagram.HasSubsystemNamed("forces") is (hands and kind == "push_hand")
    assert len(hashes) == 1


def test_the_oracle_is_told_of_a_fault_that_does_not_take_the_arm(world, encoder, policy):
    """From the tick after the onset on: ten in which it acts, and the one in which the arm is seen at home."""
    oracle, given = OracleDetector(policy, ARM_JOINTS), given_in_full("camera_dropped", 1.0, world)
    built = Rollout(world, encoder, policy, oracle, never_fires(1), fault="camera_dropped")
    _, record = run(built, policy, given, seconds=1.4)
    assert record.alpha.tolist() == [0.0] + [1.0] * 11 + [0.0] * 2
    assert not record.active.any()


class Twisted(JointOffset):
    """A fault of somebody else's."""

    name = "twisted"


def test_a_fault_of_ones_own(world, encoder, policy):
    kind = f"{__name__}:Twisted"
    outcome, _ = run(Rollout(world, encoder, policy, fault=kind), policy, given_in_full(kind, 1.0, world))
    assert outcome.disturbance == "twisted"
