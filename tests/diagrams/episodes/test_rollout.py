"""The whole closed loop in physics, with networks that know the teacher's motion by heart instead of trained ones."""

import itertools
import json
from dataclasses import fields

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import CacheIndex

from diagrams.episodes.calibration import never_fires
from diagrams.episodes.episode import Episode
from diagrams.episodes.record import PICTURE_EVERY, Record
from diagrams.episodes.switching import GUARD
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT
from diagrams.world.task import HOME_TOLERANCE, at_home
from models.errors import InputError

CAN = (0.555, -0.041)
MARK = (1, 2, 3, 4)  # no colour of a picture, whose alpha is 255


class Run:
    """One run, with what the network was fed."""

    def __init__(self, rollout, policy, encoder, episode, **options):
        calls, self.told = encoder.calls, []
        policy.learn(episode)
        self.episode = episode
        self.outcome, self.record = rollout.run(
            episode, on_event=lambda t, what: self.told.append((t, what)), **options
        )
        self.inputs = np.array(policy.inputs)
        self.encoded = encoder.calls - calls

    def words(self):
        return [what for _, what in self.told]


@pytest.fixture(scope="module")
def undisturbed(rollout, policy, encoder):
    return Run(rollout, policy, encoder, Episode(0, CAN, "left"))


def disturbed_by_A(sampler, subtask):
    """The first episode of kind A in that subtask."""
    return next(e for e in (sampler.sample(s, "A") for s in range(100)) if e.disturbance.subtask == subtask)


@pytest.fixture(scope="module")
def moved_before_the_grasp(rollout, policy, encoder, sampler):
    return Run(rollout, policy, encoder, disturbed_by_A(sampler, 1))


@pytest.fixture(scope="module")
def moved_with_the_can(rollout, policy, encoder, sampler):
    return Run(rollout, policy, encoder, disturbed_by_A(sampler, 2))


@pytest.fixture(scope="module")
def robbed(rollout, policy, encoder):
    """Stopped before the shelf; the can is taken and put elsewhere on the desk."""
    taken = DisturbanceSpec("B", level=0.10, hold_ticks=20, subtask=2, can_moved_to=[0.61, 0.05])
    return Run(rollout, policy, encoder, Episode(8, (0.50, 0.02), "right", taken))


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
    for field in fields(Record):
        a, b = getattr(first.record, field.name), getattr(again.record, field.name)
        assert a == b if field.name == "events" else a.tobytes() == b.tobytes(), field.name
    timed = {"wall_seconds", "realtime_factor"}
    assert {k: v for k, v in first.outcome.to_dict().items() if k not in timed} == {
        k: v for k, v in again.outcome.to_dict().items() if k not in timed
    }


def test_a_network_that_does_nothing_has_stalled(rollout, policy, encoder, monkeypatch):
    monkeypatch.setattr(policy, "learn", lambda episode: setattr(policy, "_paths", {}) or setattr(policy, "inputs", []))
    monkeypatch.setattr(type(encoder), "encode", lambda self, rgb: np.zeros(self.feature_size))
    run = Run(rollout, policy, encoder, Episode(0, CAN, "left"), time_limit=6.0)
    assert (run.outcome.success, run.outcome.failure, run.outcome.sim_seconds) == (False, "stalled", 6.0)
    assert run.words()[-1] == "time is up"


class Diverging:
    """A simulator whose physics ends after a second: in a step, or with a state that only the next one would find."""

    def __init__(self, simulator, plant=None):
        self._simulator, self._plant = simulator, plant

    def __getattr__(self, name):
        return getattr(self._simulator, name)

    def AdvanceTo(self, seconds):
        if seconds > 1.0 and self._plant is None:
            raise RuntimeError("a non-finite number")
        status = self._simulator.AdvanceTo(seconds)
        if seconds > 1.0:
            context = self._plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
            context.get_mutable_discrete_state_vector().SetAtIndex(self._plant.num_positions() - 1, np.inf)
        return status


@pytest.mark.parametrize("in_a_step", [True, False])
def test_a_run_that_diverges_has_failed_at_both(rollout, policy, encoder, monkeypatch, in_a_step):
    plant = None if in_a_step else rollout.station.plant
    monkeypatch.setattr(rollout, "simulator", Diverging(rollout.simulator, plant))
    run = Run(rollout, policy, encoder, Episode(0, CAN, "left"))
    assert (run.outcome.success, run.outcome.switch_success) == (False, False)
    assert run.outcome.failure == run.outcome.switch_failure == "simulation diverged"
    assert len(run.record.time) == 10


def test_a_run_that_diverges_in_its_first_tick_is_refused(rollout, policy, encoder, monkeypatch):
    monkeypatch.setattr(rollout, "advance", lambda seconds: False)
    with pytest.raises(InputError, match=r"diverges in its first tick: choose a softer world\.servo"):
        Run(rollout, policy, encoder, Episode(0, CAN, "left"))


def test_no_disturbance_came(rollout, policy, encoder):
    """The moment never comes within the time: void, neither a success nor a failure."""
    for given in (
        DisturbanceSpec("B", level=0.01, hold_ticks=20),
        DisturbanceSpec("moved", level=0.01, can_moved_to=[0.5, 0.0]),
    ):
        outcome = Run(rollout, policy, encoder, Episode(0, CAN, "left", given), time_limit=2.0).outcome
        assert (outcome.void, outcome.success, outcome.switch_failure) == (True, None, None)
        expected = None if given.takes_arm else True
        assert (outcome.switch_success, outcome.paper_switch_success) == (expected, expected)
        assert outcome.returned is (False if given.takes_arm else None)


def test_time_disturbed_is_added_to_the_limit(rollout, policy, encoder, moved_before_the_grasp):
    """The network cannot finish within the limit; how long it is given depends on the disturbance."""
    first = moved_before_the_grasp
    run = Run(rollout, policy, encoder, first.episode, time_limit=14.0)
    onset = np.flatnonzero(first.record.active)[0]
    resumed = onset + np.flatnonzero(first.record.alpha[onset + 10 :] <= 0.1)[0] + 10
    assert run.outcome.sim_seconds == pytest.approx(14.0 + 0.1 * (resumed - onset))


def test_a_run_for_the_detection_alone_ends_with_the_disturbance(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="detection")
    assert (outcome.success, outcome.failure, outcome.switch_success, outcome.paper_switch_success) == (None,) * 4
    end = np.flatnonzero(whole.record.active)[-1] + 1
    assert len(record.time) == end + 1
    assert np.array_equal(record.errors, whole.record.errors[: end + 1])


def test_a_run_for_the_switching_alone_goes_on_to_the_end_unless_it_failed(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="switching")
    assert (outcome.success, outcome.failure, outcome.paper_switch_success) == (None, None, None)
    assert (whole.outcome.success, whole.outcome.paper_switch_success) == (True, True)
    for name in ("switch_success", "detection_delay_s", "return_s", "resume_s", "switch_failure", "sim_seconds"):
        assert getattr(outcome, name) == getattr(whole.outcome, name)
    assert np.array_equal(record.errors, whole.record.errors)
    # With a detector that never fires it has failed at the end of the disturbance.
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="switching", calibration=never_fires(11))
    assert (outcome.switch_success, outcome.switch_failure) == (False, "not detected")
    assert len(record.time) == np.flatnonzero(record.active)[-1] + 2


def test_a_run_for_the_paper_s_words_ends_with_the_resumption(rollout, policy, moved_before_the_grasp):
    whole = moved_before_the_grasp
    policy.learn(whole.episode)
    outcome, record = rollout.run(whole.episode, until="as_paper")
    assert (outcome.success, outcome.switch_success, outcome.paper_switch_success) == (None, None, True)
    assert record.alpha[-1] <= 0.1 < record.alpha[-2]


def test_pictures_are_kept_where_asked_for(rollout, policy, undisturbed):
    policy.learn(undisturbed.episode)
    _, record = rollout.run(undisturbed.episode, picture_every=PICTURE_EVERY, time_limit=1.2)
    assert record.picture_ticks.tolist() == [0, 5, 10]
    assert record.pictures.shape == (3, 112, 112, 3)
    assert record.pictures.dtype == np.uint8
    assert record.posture.tobytes() == undisturbed.record.posture[:12].tobytes()
    assert len(undisturbed.record.pictures) == 0
