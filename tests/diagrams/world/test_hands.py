"""A person's hands in the closed loop: absent where not asked for, without effect where idle, and what they do."""

import numpy as np
import pytest

from diagrams.episodes.episode import Episode
from diagrams.episodes.record import record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands import HELD_TICKS
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.names import ARM_JOINTS
from diagrams.world.scenario import Scenario, load_scenario, save_scenario
from models.errors import InputError
from systems.disturbance import MOVE_TICKS

CAN = (0.555, -0.041)
FREE = [0.0] * ARM_JOINTS


@pytest.fixture(scope="module")
def handed(world, encoder, policy):
    return Rollout(world, encoder, policy, hands=True)


def run(rollout, policy, schedule=None, seconds=3.0):
    episode = Episode(0, CAN, "left", hands=schedule or HandsSchedule())
    policy.learn(episode)
    # The limit is counted from the last that the hands did.
    return rollout.run(episode, time_limit=seconds - 0.1 * episode.hands.last_tick, picture_every=5)[1]


@pytest.fixture(scope="module")
def untouched(rollout, policy):
    return run(rollout, policy)


def test_idle_hands_change_no_bit(handed, policy, untouched):
    assert record_hash(run(handed, policy)) == record_hash(untouched)


def test_late_steps_hold_the_last_command(handed, policy, untouched):
    """From tick 10 on four in ten, by the seed of the episode; the command of the record is the controller's."""
    assert record_hash(run(handed, policy, HandsSchedule(late=[[0.0, 0.0]]))) == record_hash(untouched)
    late = run(handed, policy, HandsSchedule(late=[[10.0, 0.4]]))
    assert record_hash(late) == record_hash(run(handed, policy, HandsSchedule(late=[[10.0, 0.4]])))
    assert np.array_equal(late.posture[:11], untouched.posture[:11])
    assert not np.array_equal(late.posture[11:], untouched.posture[11:])
    # All of them: the arm stays where it was, and alpha says so.
    still = run(handed, policy, HandsSchedule(late=[[10.0, 1.0]]))
    assert np.ptp(still.posture[14:, :7], axis=0).max() < np.deg2rad(0.2)
    assert still.alpha[:10].max() < 0.5 < 0.9 < still.alpha.max()
    assert not still.active.any()


def test_without_hands_there_is_none_of_their_systems(rollout):
    names = {system.get_name() for system in rollout.diagram.GetSystems()}
    assert not names & {"manual_disturbance", "camera_fault", "pull", "hands_grip", "late_step"}
    with pytest.raises(InputError, match="hands=True"):
        rollout.create_context(Episode(0, CAN, "left", hands=HandsSchedule(grip=[[3, 1.0, *FREE]])))


def test_a_run_goes_on_after_the_task_is_done_to_the_last_that_the_hands_did(handed, policy, rollout):
    """And the switching, of a person's many disturbances, is not judged, whatever was held."""
    episode = Episode(0, CAN, "left")
    policy.learn(episode)
    done, record = rollout.run(episode)
    assert done.success
    last = len(record.time) + 30
    grip = [[12.0, 1.0, *FREE], [16.0, 0.0, *FREE]]
    hands = HandsSchedule(grip=grip, can=[[last - 5.0, 0.5, 0.02]], gamma=[[float(last), 50.0]])
    outcome, longer = handed.run(Episode(0, CAN, "left", hands=hands), time_limit=1.0)
    assert len(longer.time) > last
    assert not outcome.placed
    assert not outcome.success
    assert longer.alpha[:16].max() > 0.9
    fields = "switch_success", "paper_switch_success", "switch_failure", "false_switches", "detection_delay_s"
    assert [getattr(outcome, name) for name in fields] == [None] * 5
    assert outcome.failure == "misplaced"
    assert ((last - 5) * 0.1, "the can is moved on the desk") in longer.events
    # At the last tick alone, success ends the run at once.
    only = HandsSchedule(gamma=[[float(last), 50.0]])
    outcome, longer = handed.run(Episode(0, CAN, "left", hands=only), time_limit=1.0)
    assert outcome.success
    assert len(longer.time) == last + 1


def test_held_arm_stands_and_alpha_rises(handed, policy, untouched):
    record = run(handed, policy, HandsSchedule(grip=[[12.0, 1.0, *FREE], [24.0, 0.0, *FREE]]))
    assert np.array_equal(np.flatnonzero(record.active), np.arange(12, 24))
    assert np.array_equal(record.posture[:12], untouched.posture[:12])
    assert np.ptp(record.posture[15:24, :7], axis=0).max() < np.deg2rad(0.2)
    assert record.alpha[:12].max() < 0.5 < 0.9 < record.alpha[23]


def test_moved_arm_goes_to_the_target_and_is_let_go(handed, policy, untouched):
    target = untouched.posture[10, :7] + np.deg2rad([20, 0, 0, 0, 15, 0, 0])
    schedule = HandsSchedule(grip=[[10.0, 2.0, *target], [10.0 + MOVE_TICKS + HELD_TICKS, 0.0, *FREE]])
    record = run(handed, policy, schedule)
    assert record.active.sum() == MOVE_TICKS + HELD_TICKS
    assert np.allclose(record.posture[10 + MOVE_TICKS + HELD_TICKS, :7], target, atol=np.deg2rad(1.0))


def test_a_pull_moves_the_hand_that_way_and_the_servo_brings_it_back(handed, policy, hand):
    """Its gains are those of a stiff servo: 10 N move the hand by millimetres."""
    grip = [[0.0, 1.0, *FREE]]  # so that the network has no say in it
    schedule = HandsSchedule(force=[[4.0, 0.0, 10.0, 0.0], [8.0, 0.0, 0.0, 0.0]], grip=grip)
    pulled, free = run(handed, policy, schedule, 1.6), run(handed, policy, HandsSchedule(grip=grip), 1.6)
    there, here = ([hand.grasp_position(row[:7]) for row in record.posture] for record in (pulled, free))
    offset = np.subtract(there, here)
    assert np.array_equal(pulled.posture[:5], free.posture[:5])
    assert 0.001 < offset[8][1] < 0.02
    assert np.linalg.norm(offset[8]) < 2 * offset[8][1]
    assert np.linalg.norm(offset[15]) < 0.1 * offset[8][1]


def test_the_can_is_put_elsewhere_in_one_tick(handed, policy):
    record = run(handed, policy, HandsSchedule(can=[[3.0, 0.50, 0.02], [5.0, 0.60, -0.05]]), 0.9)
    assert np.allclose(record.can_poses[2, 4:6], CAN)
    for tick, place in ((3, [0.50, 0.02]), (4, [0.50, 0.02]), (5, [0.60, -0.05]), (8, [0.60, -0.05])):
        assert np.allclose(record.can_poses[tick, 4:6], place, atol=1e-3)


def test_a_frozen_camera_shows_the_same_picture(handed, policy):
    """Pictures are kept every fifth tick."""
    schedule = HandsSchedule(camera=[[8.0, 3.0], [18.0, 1.0], [23.0, 0.0]], grip=[[1.0, 1.0, *FREE]])
    pictures = dict(zip(range(0, 30, 5), run(handed, policy, schedule).pictures, strict=True))
    assert np.array_equal(pictures[10], pictures[15])
    assert not pictures[20].any()
    assert pictures[25].any()


def test_gamma_is_turned_from_a_tick_on(handed, policy):
    """So high that what a held arm gives is below it."""
    grip = [[12.0, 1.0, *FREE], [24.0, 0.0, *FREE]]
    sharp, dull = (run(handed, policy, HandsSchedule(grip=grip, gamma=gamma)) for gamma in ([], [[14.0, 1e4]]))
    assert np.array_equal(dull.alpha[:14], sharp.alpha[:14])
    assert sharp.alpha[14:24].max() > 0.9 > 0.5 > dull.alpha[14:24].max()


def test_done_live_is_done_again_to_the_same_bits(handed, policy, tmp_path):
    """What is added at the ticks as they come, through a scenario file, and had from the start."""
    episode = Episode(0, CAN, "left")
    policy.learn(episode)
    handed.prepare(episode)
    root, hands, live = handed.simulator.get_mutable_context(), handed.hands, []
    target = np.deg2rad([40.1, 30.3, 10.7, 83.9, 1 / 3, 62.0, 0.0])
    done = {
        5: lambda k: hands.hold(root, k, True), 9: lambda k: hands.hold(root, k, False),
        11: lambda k: hands.move(root, k, target), 13: lambda k: hands.put_can(root, k, np.array([0.5, 1 / 30])),
        14: lambda k: hands.pull(root, k, np.array([0.1, 20.0, -3.3])), 16: lambda k: hands.fault(root, k, "frozen"),
        17: lambda k: hands.set_gamma(root, k, 77.7),
    }  # fmt: skip
    for k in range(30):
        done.get(k, lambda k: None)(k)
        handed.simulator.AdvanceTo((k + 0.5) * 0.1)
        ports = handed.controller.GetOutputPort("measured_posture"), handed.controller.GetOutputPort("alpha")
        live.append([port.Eval(handed.controller.GetMyContextFromRoot(root)).copy() for port in ports])
    save_scenario(tmp_path / "s.yaml", Scenario(hands=hands.schedule(root)))
    loaded = load_scenario(tmp_path / "s.yaml").hands
    assert loaded == hands.schedule(root)
    assert loaded.can == [[13.0, 0.5, 1 / 30]]
    record = run(handed, policy, loaded)
    assert len(record.time) == 30
    assert np.array([posture for posture, _ in live]).tobytes() == record.posture.tobytes()
    assert np.array([alpha[0] for _, alpha in live]).tobytes() == record.alpha.tobytes()


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        ({"grip": [[1.0, 1.0]]}, "hands.grip has the row .*a tick and 8"),
        ({"grip": [[1.0, 3.0, *FREE]]}, "hands.grip has the kind 3.0"),
        ({"force": [[2.0, 0, 0, 0], [2.0, 0, 0, 0]]}, "hands.force has the tick 2.0 after 2.0"),
        ({"force": [[2.5, 0, 0, 0]]}, "hands.force has the tick 2.5"),
        ({"can": [[2.0, 0.5, float("nan")]]}, "hands.can has the row"),
        ({"camera": [[2.0, 4.0]]}, "hands.camera has the kind 4.0"),
        ({"gamma": [[2.0, -1.0]]}, "gamma -1.0 is outside of 1 to 10000"),
        ({"gamma": [[2.0, 20_000.0]]}, "gamma 20000.0 is outside"),
        ({"force": [[2.0, 0, -60.5, 0]]}, "-60.5, 0.0. N is too large"),
        ({"late": [[1.0, 1.5]]}, "share of late steps 1.5 is no share: choose 0 to 1"),
        ({"camera": [[1e12, 0.0]]}, "hands.camera has the tick 1e.12: give at most"),
    ],
)
def test_what_no_hands_did_is_refused(rows, named):
    with pytest.raises(InputError, match=named):
        Scenario(hands=HandsSchedule(**rows)).check()


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        ({"grip": [[1.0, 2.0, 9.0, *FREE[1:]]]}, "hands.grip .* outside of the joint limits"),
        ({"can": [[1.0, 0.9, 0.0]]}, "out of reach"),
    ],
)
def test_what_depends_on_the_world_is_refused_before_the_run(sampler, rows, named):
    with pytest.raises(InputError, match=named):
        sampler.episode(Scenario(disturbance=DisturbanceSpec(), hands=HandsSchedule(**rows)))


def test_a_hand_that_holds_goes_on_after_a_move_and_a_release_waits_for_its_end(handed):
    root, hands = handed.diagram.CreateDefaultContext(), handed.hands
    end, target = 5.0 + MOVE_TICKS + HELD_TICKS, [0.1] * ARM_JOINTS
    hands.hold(root, 2, True)
    hands.move(root, 5, np.array(target), held=True)
    before = [[2.0, 1.0, *FREE], [5.0, 2.0, *target]]
    assert hands.schedule(root).grip == [*before, [end, 1.0, *FREE]]
    hands.hold(root, 9, False)
    assert hands.schedule(root).grip == [*before, [end, 0.0, *FREE]]
    hands.hold(root, 30, True)
    hands.hold(root, 31, False)
    assert [row[:2] for row in hands.schedule(root).grip[2:]] == [[end, 0.0], [30.0, 1.0], [31.0, 0.0]]
    assert hands.newest(root, "force").tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("act", "named"),
    [
        (lambda hands, root: hands.pull(root, 1, np.array([0.0, 0.0, 61.0])), "too large: choose at most 60"),
        (lambda hands, root: hands.fault(root, 1, "stolen"), "no camera fault 'stolen': choose from clear, covered"),
        (lambda hands, root: hands.set_gamma(root, 1, float("nan")), "gamma nan is outside of 1 to 10000"),
    ],
)
def test_what_no_hand_can_do_is_refused(handed, act, named):
    root = handed.diagram.CreateDefaultContext()
    with pytest.raises(InputError, match=named):
        act(handed.hands, root)
    assert not handed.hands.schedule(root)
