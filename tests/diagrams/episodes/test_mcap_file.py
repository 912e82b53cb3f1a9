"""MCAP files, read back by the package mcap and its Protobuf decoder: they hold what the record has."""

import io
from collections import defaultdict
from dataclasses import replace

import cv2
import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation, Slerp

from diagrams.episodes.calibration import never_fires
from diagrams.episodes.episode import Episode
from diagrams.episodes.mcap_file import JOINT_NAMES, mcap_bytes, save_mcap
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from tests.diagrams.episode_fakes import OUTCOME
from tests.diagrams.recorded_run import recorded_run

N = 60
SCHEMAS = {
    "/camera": "foxglove.CompressedImage", "/joint_states": "foxglove.JointStates", "/command": "foxglove.JointStates",
    "/imagined_posture": "foxglove.JointStates", "/controller": "hindsight.Controller",
    "/tf": "foxglove.FrameTransforms", "/events": "foxglove.Log",
}  # fmt: skip


@pytest.fixture(scope="module")
def record(world):
    """A made-up run near the initial posture, its cans turning; no two numbers alike; pictures of noise."""
    run, rng = recorded_run(N), np.random.default_rng(3)
    angles, positions = rng.uniform(-3, 3, (N, 2)), rng.normal(size=(N, 2, 3))
    cans = [
        [np.cos(a / 2), 0, np.sin(a / 2), 0, *p] for row, xyz in zip(angles, positions, strict=True)
        for a, p in zip(row, xyz, strict=True)
    ]  # fmt: skip
    return replace(
        run, posture=world.initial_posture + 0.1 * run.posture, desired_posture=rng.normal(size=(N, 8)),
        errors=rng.uniform(size=(N, 11)), alpha=rng.uniform(size=N), can_poses=np.reshape(cans, (N, 14)),
        pictures=rng.integers(0, 256, run.pictures.shape, np.uint8),
    )  # fmt: skip


@pytest.fixture(scope="module")
def messages(record):
    """By topic, (nanoseconds, schema, message) in the order of time."""
    return read(mcap_bytes(record, OUTCOME, World()))


def read(content):
    found = defaultdict(list)
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    for schema, channel, raw, message in reader.iter_decoded_messages():
        found[channel.topic].append((raw.log_time, schema.name, message))
    return found


def nanoseconds(record):
    return [round(1e9 * seconds) for seconds in record.time]


def test_topics_schemas_counts_and_times(record, messages):
    assert {topic: {schema for _, schema, _ in rows} for topic, rows in messages.items()} == {
        topic: {schema} for topic, schema in SCHEMAS.items()
    }
    for topic in SCHEMAS.keys() - {"/camera", "/tf", "/events"}:
        assert [when for when, _, _ in messages[topic]] == nanoseconds(record), topic
    half = 5 * 10**7  # the record looks at plant and camera in the middle of the tick
    assert [when for when, _, _ in messages["/camera"]] == [10**8 * k + half for k in range(0, N, 5)]
    assert [when for when, _, _ in messages["/tf"]] == [half * i for i in range(2 * N)]
    for topic in SCHEMAS.keys() - {"/tf"}:
        assert all(message.timestamp.ToNanoseconds() == when for when, _, message in messages[topic]), topic


def test_postures_to_the_bit(record, messages):
    def rows(topic):
        for _, _, message in messages[topic]:
            assert tuple(joint.name for joint in message.joints) == JOINT_NAMES
        return np.array([[joint.position for joint in message.joints] for _, _, message in messages[topic]])

    assert np.array_equal(rows("/joint_states"), record.posture)
    assert np.array_equal(rows("/command"), record.desired_posture)


def test_controller_to_the_bit(record, messages):
    found = [message for _, _, message in messages["/controller"]]
    assert np.array_equal([message.alpha for message in found], record.alpha)
    assert np.array_equal([list(message.errors) for message in found], record.errors)
    assert [message.disturbed for message in found] == (record.active > 0.5).tolist()
    assert [message.mode for message in found] == np.where(record.alpha >= 0.5, "return", "task").tolist()


def test_pictures_to_the_pixel(record, messages):
    for (_, _, message), picture in zip(messages["/camera"], record.pictures, strict=True):
        assert (message.format, message.frame_id) == ("png", "camera")
        bgr = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(bgr[:, :, ::-1], picture)


def test_transforms_are_those_of_the_station(record, messages, station):
    plant = station.plant
    context = plant.CreateDefaultContext()
    for k in (0, N - 1):
        pair = messages["/tf"][2 * k : 2 * k + 2]
        found = {t.child_frame_id: t for _, _, message in pair for t in message.transforms}
        for when, _, message in pair:
            assert {t.parent_frame_id for t in message.transforms} == {"world"}
            assert {t.timestamp.ToNanoseconds() for t in message.transforms} == {when}
        for j, angle in enumerate(record.posture[k, :7]):
            plant.GetJointByName(f"joint_{j + 1}").set_angle(context, angle)
        for side in ("left", "right"):
            joint = plant.GetJointByName(f"{side}_finger_joint")
            joint.set_translation(context, record.posture[k, 7] / 2)
        for model in ("arm", "gripper"):
            for index in plant.GetBodyIndices(plant.GetModelInstanceByName(model)):
                body = plant.get_body(index)
                X = plant.EvalBodyPoseInWorld(context, body)
                t = found.pop(body.scoped_name().get_full())
                np.testing.assert_allclose([t.translation.x, t.translation.y, t.translation.z], X.translation())
                q = X.rotation().ToQuaternion().wxyz()
                r = [t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z]
                assert abs(np.dot(q, r)) == pytest.approx(1.0)
        assert found.keys() == {"camera", "can_to_pick", "can_on_shelf"}
        for name, pose in zip(("can_to_pick", "can_on_shelf"), record.can_poses[k].reshape(2, 7), strict=True):
            t = found[name]
            np.testing.assert_allclose([t.translation.x, t.translation.y, t.translation.z], pose[4:])
            r = [t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z]
            assert abs(np.dot(pose[:4], r)) == pytest.approx(1.0)


def test_events_and_outcome(record, messages):
    assert [(when / 1e9, message.message) for when, _, message in messages["/events"]] == record.events
    reader = make_reader(io.BytesIO(mcap_bytes(record, OUTCOME, World())))
    (metadata,) = reader.iter_metadata()
    assert metadata.name == "outcome"
    assert metadata.metadata["detection_delay_s"] == str(OUTCOME.detection_delay_s)
    assert MessageToDict(messages["/events"][0][2])["level"] == "INFO"


def test_the_same_record_gives_the_same_file(record, tmp_path):
    save_mcap(tmp_path / "new" / "run.mcap", record, OUTCOME, World())
    assert (tmp_path / "new" / "run.mcap").read_bytes() == mcap_bytes(record, OUTCOME, World())


@pytest.fixture(scope="module")
def flown(rollout, policy):
    """The messages of twelve seconds in which the can is picked; what the network predicts in the last tick, scaled."""
    episode = Episode(0, (0.555, -0.041), "left", DisturbanceSpec())
    policy.learn(episode)
    outcome, record = rollout.run(episode, calibration=never_fires(11), time_limit=12.0)
    controller = rollout.controller
    context = controller.GetMyContextFromRoot(rollout.simulator.get_context())
    row = controller.GetOutputPort("recalled_postures").Eval(context)[:8].copy()
    return read(mcap_bytes(record, outcome, rollout.world)), row


def test_imagined_posture_is_the_forecast_of_the_tick(flown, policy):
    """Eq. 3 undone: what the network itself says."""
    found, row = flown
    when, _, message = found["/imagined_posture"][-1]
    assert when == found["/joint_states"][-1][0]  # it was made then
    posture = [joint.position for joint in message.joints]
    np.testing.assert_allclose(posture, policy.scaling.unscale(row), rtol=0.0, atol=1e-12)


def test_a_held_can_rests_in_the_hand(flown):
    """In the palm's frame between its two messages around the can's."""
    found, _ = flown
    poses = defaultdict(list)
    for when, _, message in found["/tf"]:
        for t in message.transforms:
            xyz, q = t.translation, t.rotation
            poses[t.child_frame_id].append((when, [xyz.x, xyz.y, xyz.z], [q.x, q.y, q.z, q.w]))
    (palm,) = (name for name in poses if name.endswith("palm"))
    times, xyz, turns = (np.array(column) for column in zip(*poses[palm], strict=True))
    when, cans, _ = (np.array(column) for column in zip(*poses["can_to_pick"], strict=True))
    held = (when < times[-1]) & (cans[:, 2] > cans[0, 2] + 0.02)
    assert held.sum() > 20
    when, cans = when[held], cans[held]
    palms = np.array([np.interp(when, times, column) for column in xyz.T]).T
    seen = Slerp(times, Rotation.from_quat(turns))(when).inv().apply(cans - palms)
    assert np.ptp(cans, axis=0).max() > 0.1  # m: it is carried
    assert np.ptp(seen, axis=0).max() < 0.004
