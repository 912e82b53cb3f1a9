"""The whole closed loop in physics, with networks that know the teacher's motion by heart instead of trained ones."""

import itertools
import json
from dataclasses import fields

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import CacheIndex

from diagrams.episodes.episode import Episode
from diagrams.episodes.record import PICTURE_EVERY, Record
from diagrams.episodes.switching import GUARD
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT
from diagrams.world.task import HOME_TOLERANCE, at_home
from tests.diagrams.episodes.whole_run import CAN, Run

MARK = (1, 2, 3, 4)  # no colour of a picture, whose alpha is 255


def assert_task_done(run):
    outcome = run.outcome
    assert (outcome.picked, outcome.placed, outcome.home, outcome.success) == (True, True, True, True)
    assert outcome.failure is None
    assert run.words()[-1] == "task done"


def test_undisturbed_task_is_done(undisturbed):
    assert_task_done(undisturbed)
    outcome = undisturbed.outcome
    assert (outcome.switched, outcome.false_switches, outcome.switch_success) == (False, 0, True)
    assert outcome.returned is outcome.resumed is outcome.detection_delay_s is None
    assert undisturbed.record.alpha.max() < 1e-6
    assert not undisturbed.record.active.any()
    assert undisturbed.words() == [
        "subtask 1: pick the can", "picked; subtask 2: place the can", "placed", "task done",
    ]  # fmt: skip


def test_outcome_is_json(undisturbed, moved_with_the_can):
    for run in (undisturbed, moved_with_the_can):
        assert json.loads(json.dumps(run.outcome.to_dict()))["success"] is True


def test_records_have_a_row_a_tick(undisturbed, policy):
    record, n = undisturbed.record, len(undisturbed.record.time)
    shapes = {
        "posture": (8,), "rnn_step": (8,), "regulator_step": (8,), "desired_posture": (8,), "alpha": (), "active": (),
        "errors": (11,), "hidden_state": (policy.state_size,), "can_poses": (14,),
        "network_input": (8 + policy.feature_size,), "predicted_features": (policy.feature_size,), "time": (),
        "signals": (7,), "tick_seconds": (),
    }  # fmt: skip
    assert {f.name for f in fields(Record)} == {*shapes, "picture_ticks", "pictures", "events"}
    assert {name: getattr(record, name).shape for name in shapes} == {name: (n, *s) for name, s in shapes.items()}
    assert undisturbed.outcome.sim_seconds == pytest.approx(0.1 * n)
    assert record.time == pytest.approx(0.1 * np.arange(n))


def test_ticks_are_aligned(undisturbed, policy, world):
    """Row k of the record is what the network got and gave in tick k."""
    record, inputs = undisturbed.record, undisturbed.inputs
    assert len(inputs) == len(record.time)  # one update a tick
    assert undisturbed.encoded == len(record.time)  # one picture a tick
    assert policy.scaling.unscale(inputs[:, :8]) == pytest.approx(record.posture, abs=1e-12)
    assert np.array_equal(inputs, record.network_input)


def test_command_of_a_tick_is_equation_3(undisturbed, moved_with_the_can, world):
    for run in (undisturbed, moved_with_the_can):
        record, joints = run.record, np.s_[:, :ARM_JOINTS]
        mixed = record.posture + (1 - record.alpha[:, None]) * record.rnn_step + record.regulator_step
        off = np.abs(record.desired_posture - mixed)[joints].max(axis=1)
        assert np.all((off < 1e-9) | (record.alpha >= 0.5))
        assert np.mean(off < 1e-9) > 0.99  # on the way home the clearance filter may change a step
        # The fingers take two values, as predicted, and keep theirs under alpha >= 1/2.
        command, predicted = record.desired_posture[:, -1], record.posture[:, -1] + record.rnn_step[:, -1]
        assert np.isin(command.round(9), (world.opening, world.closed_opening)).all()
        kept = (record.alpha >= 0.5) | ((predicted > 0.045) & (predicted < 0.065))
        assert np.array_equal(command[kept], record.posture[kept, -1])
        assert np.array_equal(command[~kept] > 0.055, predicted[~kept] > 0.055)
        pull = -0.1 * (record.posture - world.initial_posture)
        pull[:, -1] = 0.0
        assert record.regulator_step == pytest.approx(pull, abs=1e-6)


def test_arm_has_followed_the_command_by_the_next_tick(undisturbed):
    """No tick is lost between the command and the posture."""
    record = undisturbed.record
    lag = np.abs(record.posture[1:, :ARM_JOINTS] - record.desired_posture[:-1, :ARM_JOINTS])
    assert lag.max() < np.deg2rad(0.5)
    assert np.abs(np.diff(record.posture[:, :ARM_JOINTS], axis=0)).max() > np.deg2rad(1.5)
    assert np.array_equal(record.posture[1:, -1], record.desired_posture[:-1, -1])


def test_loop_is_closed_with_alpha_of_the_tick(moved_with_the_can, policy):
    record, inputs = moved_with_the_can.record, moved_with_the_can.inputs
    assert record.alpha.max() > 0.999
    # At home under alpha >= 1/2 it starts anew instead of stepping.
    off = np.abs(record.posture[:, :7] - policy.initial_posture[:7]).max(axis=1)
    stepped = (record.alpha < 0.5) | (off > HOME_TOLERANCE)
    assert 0 < np.count_nonzero(~stepped) < 30
    assert np.array_equal(inputs, record.network_input[stepped])
    share = 1.0 - record.alpha[stepped]
    # The fake sees 1 in its first feature, and predicts 0.
    assert inputs[:, 8] == pytest.approx(share, abs=1e-12)
    assert moved_with_the_can.encoded == np.count_nonzero(share) < len(share)  # no picture where alpha is exactly 1
    measured = policy.scaling.scale(record.posture[stepped])
    imagined = share < 1e-3
    assert np.abs(inputs[:, :7] - measured[:, :7]).max(axis=1)[imagined].max() > 0.05
    assert inputs[~imagined & (share > 1 - 1e-9), :8] == pytest.approx(
        measured[~imagined & (share > 1 - 1e-9)], abs=1e-6
    )


@pytest.mark.parametrize("name", ["moved_before_the_grasp", "moved_with_the_can"])
def test_moved_arm_goes_home_and_finishes(name, request, world):
    run = request.getfixturevalue(name)
    outcome, record, given = run.outcome, run.record, run.episode.disturbance
    assert_task_done(run)
    assert (outcome.switched, outcome.returned, outcome.resumed, outcome.switch_success) == (True, True, True, True)
    assert outcome.switch_failure is None
    assert 0.0 <= outcome.detection_delay_s <= 0.5
    assert outcome.false_switches == 0
    assert outcome.alpha_max_before < 1e-6
    # 8 ticks of the move and the hold; then the arm is where it was brought to.
    active = np.flatnonzero(record.active)
    assert np.array_equal(active, np.arange(active[0], active[0] + 8 + given.hold_ticks))
    assert record.posture[active[-1], :7] == pytest.approx(np.array(given.target), abs=np.deg2rad(1.0))
    # The LQR takes a tenth of what is left a tick; the fingers keep their command.
    end = active[-1] + 1
    off = np.abs(record.posture[end : end + 15, :7] - world.initial_posture[:7]).max(axis=1)
    assert off[1:] == pytest.approx(0.9 * off[:-1], rel=0.1)
    away = record.alpha > 0.999
    assert len(set(record.posture[away, -1])) == 1
    words = run.words()
    order = [
        "the experimenter disturbs the arm", "recall fails: switched to the LQR", "at the initial posture",
        "recalls again: the network resumes", "placed", "task done",
    ]  # fmt: skip
    assert [word for word in words if word in order] == order


def test_fingers_that_hold_a_can_never_open_during_the_return(moved_with_the_can):
    """The network imagines that it has put the can down; when it has the arm again, the can is still in the hand."""
    record = moved_with_the_can.record
    resumed = np.flatnonzero(record.alpha > 0.5)[-1] + 1
    assert np.all(record.desired_posture[resumed - 20 : resumed + 10, -1] < 0.05)


def test_robbed_hand_goes_home_and_picks_the_can_up_again(robbed):
    assert_task_done(robbed)
    assert robbed.outcome.switch_success
    words = robbed.words()
    assert "the can is taken from the hand and put elsewhere on the desk" in words
    assert words.count("picked; subtask 2: place the can") == 2
    active = np.flatnonzero(robbed.record.active)
    assert np.array_equal(active, np.arange(active[0], active[0] + 20))
    # Stopped: the arm stands where it was.
    stopped = robbed.record.posture[active[2:], :7]
    assert np.ptp(stopped, axis=0).max() < np.deg2rad(0.5)


def state_bytes(root):
    """All that the Context holds, without its logs."""
    groups = [root.get_discrete_state(i).value() for i in range(root.num_discrete_state_groups())]
    assert root.num_total_states() == sum(map(len, groups))
    return np.concatenate(groups).tobytes()


@pytest.mark.parametrize(("name", "opens"), [("robbed", True), ("moved_with_the_can", False)])
def test_at_home_empty_fingers_open_and_a_held_can_is_kept(request, world, name, opens):
    record = request.getfixturevalue(name).record
    home = at_home(record.posture[:, :ARM_JOINTS], world.initial_posture[:ARM_JOINTS])
    waits = np.flatnonzero(home & (record.alpha >= GUARD) & (record.time > record.time[record.active].max()))
    assert len(waits) > 5
    # The command of a row is that of the tick before: from the second row on they are of the arm at home.
    assert np.all((record.desired_posture[waits[1:], -1] == world.opening) == opens)
    before = record.desired_posture[np.flatnonzero(record.active), -1]
    assert np.all(before == world.closed_opening)


@pytest.mark.parametrize("name", ["undisturbed", "moved_with_the_can", "robbed"])
def test_a_simulator_alone_gives_the_same_bits(rollout, policy, request, name):
    """The two lines that a user writes himself: the can is taken from the hand by an event of the diagram."""
    run = request.getfixturevalue(name)
    policy.learn(run.episode)
    simulator = Simulator(rollout.diagram, rollout.create_context(run.episode))
    simulator.AdvanceTo((len(run.record.time) - 0.5) * 0.1)
    assert np.array_equal(policy.inputs, run.inputs)
    own, plain = rollout.simulator, simulator.get_context()
    policy.learn(run.episode)
    rollout.run(run.episode)
    assert own.get_context().get_time() == plain.get_time()
    assert state_bytes(own.get_context()) == state_bytes(plain)


def test_a_clone_goes_on_to_the_same_bits_in_another_simulator(rollout, policy, robbed):
    """Cloned with the can in the hand, just before it is taken, and just after."""
    onset = np.flatnonzero(robbed.record.active)[0]
    policy.learn(robbed.episode)
    simulator = Simulator(rollout.diagram, rollout.create_context(robbed.episode))

    def go_on(simulator):
        simulator.AdvanceTo((onset + 12.5) * 0.1)
        return state_bytes(simulator.get_context())

    clones = []
    for ticks, taken in ((onset - 3, False), (onset + 4, False), (onset + 4.5, True), (onset + 5.5, True)):
        simulator.AdvanceTo(ticks * 0.1)
        clones.append(simulator.get_context().Clone())
        port, root = rollout.station.GetOutputPort("can_poses"), clones[-1]
        cans = port.Eval(rollout.station.GetMyContextFromRoot(root))
        assert (np.hypot(*(cans[4:6] - robbed.episode.disturbance.can_moved_to)) < 1e-9) == taken
    assert {go_on(Simulator(rollout.diagram, clone)) for clone in clones} == {go_on(simulator)}


def test_a_can_alone_is_moved_while_the_hand_comes(rollout, policy, encoder, undisturbed):
    """From the onset's tick on it is elsewhere; the arm is left alone, and this network does not look again."""
    place = [CAN[0] + 0.03, CAN[1] + 0.04]
    given = DisturbanceSpec("moved", level=0.15, can_moved_to=place)
    run = Run(rollout, policy, encoder, Episode(0, CAN, "left", given), time_limit=7.0)
    outcome, record = run.outcome, run.record
    moved = np.hypot(*(record.can_poses[:, 4:6] - CAN).T) > 0.02
    first = int(np.argmax(moved))
    assert record.can_poses[first, :7] == pytest.approx([1, 0, 0, 0, *place, CAN_HALF_HEIGHT], abs=1e-3)
    assert 0 < first < len(moved) - 5
    assert not record.active.any()
    same = record.posture[: first + 1]
    assert same.tobytes() == undisturbed.record.posture[: first + 1].tobytes()
    assert np.abs(np.diff(record.posture[first : first + 5, :7], axis=0)).max(axis=1).min() > np.deg2rad(0.1)  # no stop
    assert (outcome.void, outcome.success, outcome.switch_success, outcome.returned) == (False, False, True, None)
    assert outcome.detection_delay_s is None
    assert "the can is moved on the desk" in run.words()


def test_the_can_is_where_it_was_put_at_once(robbed):
    """In the middle of the fifth tick of the disturbance, upright, at rest."""
    onset = np.flatnonzero(robbed.record.active)[0]
    before, after = robbed.record.can_poses[onset + 3 : onset + 5]
    x, y = robbed.episode.disturbance.can_moved_to
    assert before[6] > 0.15
    # One plant step of rest, or of falling within it, at most.
    assert after[:7] == pytest.approx([1, 0, 0, 0, x, y, CAN_HALF_HEIGHT], abs=1e-3)
    assert robbed.words().index("the can is taken from the hand and put elsewhere on the desk") > 0


def test_a_tick_renders_once_where_a_picture_is_needed(rollout, policy, moved_with_the_can):
    """Whatever is logged and judged. Counted by a mark in the picture's memory that the next rendering wipes off."""
    whole = moved_with_the_can.record
    policy.learn(moved_with_the_can.episode)
    simulator = Simulator(rollout.diagram, rollout.create_context(moved_with_the_can.episode))
    camera = rollout.station.GetSubsystemByName("camera")
    context = camera.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    entries = (camera.get_cache_entry(CacheIndex(i)) for i in itertools.count())
    picture = next(entry for entry in entries if "color_image" in entry.description())
    needed = whole.alpha != 1.0
    rendered = np.zeros(len(needed), int)
    steps = round(0.1 / rollout.world.timing.time_step)
    for step in range(steps * len(needed)):  # after each, the plant has moved, and the picture is out of date
        memory = picture.get_mutable_cache_entry_value(context).GetMutableValueOrThrow().mutable_data
        memory[0, 0] = MARK
        simulator.AdvanceTo((step + 0.5) / steps * 0.1)
        rendered[step // steps] += tuple(memory[0, 0]) != MARK
    assert np.array_equal(rendered, needed.astype(int))


def test_same_episode_gives_the_same_bits(rollout, policy, encoder, moved_before_the_grasp):
    first = moved_before_the_grasp
    again = Run(rollout, policy, encoder, first.episode)
    for name in {field.name for field in fields(Record)} - {"tick_seconds"}:
        a, b = getattr(first.record, name), getattr(again.record, name)
        assert a == b if name == "events" else a.tobytes() == b.tobytes(), name
    timed = {"wall_seconds", "realtime_factor"}
    assert {k: v for k, v in first.outcome.to_dict().items() if k not in timed} == {
        k: v for k, v in again.outcome.to_dict().items() if k not in timed
    }


def test_pictures_are_kept_where_asked_for(rollout, policy, undisturbed):
    policy.learn(undisturbed.episode)
    _, record = rollout.run(undisturbed.episode, picture_every=PICTURE_EVERY, time_limit=1.2)
    assert record.picture_ticks.tolist() == [0, 5, 10]
    assert record.pictures.shape == (3, 112, 112, 3)
    assert record.pictures.dtype == np.uint8
    assert record.posture.tobytes() == undisturbed.record.posture[:12].tobytes()
    assert len(undisturbed.record.pictures) == 0
