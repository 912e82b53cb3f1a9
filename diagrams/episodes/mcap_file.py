"""A run as an MCAP file, which Foxglove, Rerun and PlotJuggler open: a message a topic and tick.

Times count from the start of the run: t_k of the tick, or its middle t_k + T/2, where a record looks at the plant.
Topics, with Foxglove's schemas in Protobuf but for `/controller`:

    /camera: CompressedImage, PNG, at t_k + T/2: what the camera shows then, where the record has a picture; not what
        the network saw at t_k, half a tick before.
    /joint_states: JointStates at t_k: m_k as sampled: joints, rad, and the commanded finger opening, m.
    /command: JointStates at t_k: the command of the tick.
    /imagined_posture: JointStates at t_k, when it was made: m^R_{k+1}, the network's forecast for t_{k+1}.
    /controller: hindsight.Controller at t_k: alpha, errors, mode (`task` below alpha 1/2, else `return`), disturbed.
    /tf: FrameTransforms from `world`, m: at t_k arm and gripper at m_k, and the camera; at t_k + T/2 the cans.
    /events: Log: what happened.

The metadata record `outcome` has what came of the run.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydrake.math import RigidTransform

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CANS
from diagrams.world.station import arm_plant
from models.files.container import write_bytes
from systems.detector import GUARD

JOINT_NAMES = (*(f"joint_{j + 1}" for j in range(ARM_JOINTS)), "opening")
POSTURES = {"/joint_states": "posture", "/command": "desired_posture"}  # topic: field of Record
CONTROLLER = "hindsight.Controller"


def save_mcap(path: Path, record: Record, outcome: Outcome, world: World) -> None:
    """Writes `record` and `outcome` of a run in `world` to `path` (.mcap)."""
    write_bytes(path, mcap_bytes(record, outcome, world))


def mcap_bytes(record: Record, outcome: Outcome, world: World) -> bytes:
    """The content of an MCAP file; see this module. Needs foxglove-sdk."""
    import foxglove
    from foxglove import channels, messages

    context, file = foxglove.Context(), io.BytesIO()
    schema, Controller = _controller()
    frames = _transforms(record, world)
    with foxglove.open_mcap(file, context=context) as writer:
        camera = channels.CompressedImageChannel("/camera", context=context)
        transforms = channels.FrameTransformsChannel("/tf", context=context)
        events = channels.LogChannel("/events", context=context)
        controller = foxglove.Channel("/controller", schema=schema, message_encoding="protobuf", context=context)
        postures = {name: getattr(record, field) for name, field in POSTURES.items()}
        postures["/imagined_posture"] = record.posture + record.rnn_step + record.regulator_step
        states = {name: channels.JointStatesChannel(name, context=context) for name in postures}
        pictures = dict(zip(record.picture_ticks.tolist(), record.pictures, strict=True))
        for k, seconds in enumerate(record.time):
            nanoseconds, stamp = _time(seconds)
            for name, channel in states.items():
                named = zip(JOINT_NAMES, postures[name][k].tolist(), strict=True)
                joints = [messages.JointState(name=joint, position=value) for joint, value in named]
                channel.log(messages.JointStates(timestamp=stamp, joints=joints), log_time=nanoseconds)
            message = Controller(
                alpha=record.alpha[k], errors=record.errors[k], disturbed=bool(record.active[k] > 0.5),
                mode="return" if record.alpha[k] >= GUARD else "task",
            )  # fmt: skip
            message.timestamp.FromNanoseconds(nanoseconds)
            controller.log(message.SerializeToString(), log_time=nanoseconds)
            moved = [_transform(name, X, stamp) for name, X in next(frames).items()]
            transforms.log(messages.FrameTransforms(transforms=moved), log_time=nanoseconds)
            nanoseconds, stamp = _time(seconds + 0.5 * world.timing.period)
            cans = zip(CANS, record.can_poses[k].reshape(-1, 7), strict=True)
            moved = [_transform(name, _pose(pose), stamp) for name, pose in cans]
            transforms.log(messages.FrameTransforms(transforms=moved), log_time=nanoseconds)
            if k in pictures:
                png = cv2.imencode(".png", cv2.cvtColor(pictures[k], cv2.COLOR_RGB2BGR))[1].tobytes()
                image = messages.CompressedImage(timestamp=stamp, frame_id="camera", data=png, format="png")
                camera.log(image, log_time=nanoseconds)
        for seconds, what in record.events:
            nanoseconds, stamp = _time(seconds)
            words = messages.Log(timestamp=stamp, level=messages.LogLevel.Info, message=what, name="hindsight")
            events.log(words, log_time=nanoseconds)
        writer.write_metadata("outcome", {name: str(value) for name, value in outcome.to_dict().items()})
    return file.getvalue()


def _time(seconds: float) -> tuple[int, Any]:
    """Nanoseconds, and as a message's timestamp."""
    from foxglove.messages import Timestamp

    nanoseconds = round(seconds * 1e9)
    return nanoseconds, Timestamp(*divmod(nanoseconds, 10**9))


def _transform(name: str, X_WF: RigidTransform, stamp: Any) -> Any:
    from foxglove.messages import FrameTransform, Quaternion, Vector3

    q, (x, y, z) = X_WF.rotation().ToQuaternion(), X_WF.translation().tolist()
    return FrameTransform(
        timestamp=stamp, parent_frame_id="world", child_frame_id=name, translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=q.x(), y=q.y(), z=q.z(), w=q.w()),
    )  # fmt: skip


def _transforms(record: Record, world: World) -> Iterator[dict[str, RigidTransform]]:
    """Poses of arm, gripper and camera in the world by the names of the frames, tick by tick."""
    plant = arm_plant(world)
    context = plant.CreateDefaultContext()
    frames = {frame.scoped_name().get_full(): frame for i in ("arm", "gripper") for frame in (
        plant.get_body(body).body_frame() for body in plant.GetBodyIndices(plant.GetModelInstanceByName(i))
    )}  # fmt: skip
    frames["camera"] = plant.GetFrameByName("camera")
    for posture in record.posture:
        plant.SetPositions(context, np.append(posture[:ARM_JOINTS], [0.5 * posture[ARM_JOINTS]] * 2))
        yield {name: frame.CalcPoseInWorld(context) for name, frame in frames.items()}


def _pose(can_pose: np.ndarray) -> RigidTransform:
    """Of (7,): quaternion w, x, y, z and position, m."""
    from pydrake.common.eigen_geometry import Quaternion

    return RigidTransform(Quaternion(can_pose[:4] / np.linalg.norm(can_pose[:4])), can_pose[4:])


def _controller() -> tuple[Any, Any]:
    """The schema of `/controller`, for which Foxglove has none, and its message class."""
    import foxglove
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    kinds = descriptor_pb2.FieldDescriptorProto
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    package, name = CONTROLLER.split(".")
    file = descriptor_pb2.FileDescriptorProto(
        name="hindsight.proto", package=package, syntax="proto3", dependency=[stamp.name]
    )
    message = file.message_type.add(name=name)
    for number, (field, kind, label) in enumerate(
        (
            ("timestamp", kinds.TYPE_MESSAGE, kinds.LABEL_OPTIONAL),
            ("alpha", kinds.TYPE_DOUBLE, kinds.LABEL_OPTIONAL),
            ("errors", kinds.TYPE_DOUBLE, kinds.LABEL_REPEATED),
            ("mode", kinds.TYPE_STRING, kinds.LABEL_OPTIONAL),
            ("disturbed", kinds.TYPE_BOOL, kinds.LABEL_OPTIONAL),
        ),
        start=1,
    ):
        of_type = ".google.protobuf.Timestamp" if kind == kinds.TYPE_MESSAGE else None
        message.field.add(name=field, number=number, type=kind, label=label, type_name=of_type)
    pool = descriptor_pool.DescriptorPool()
    for part in (stamp, file):
        pool.Add(part)
    data = descriptor_pb2.FileDescriptorSet(file=[stamp, file]).SerializeToString(deterministic=True)
    schema = foxglove.Schema(name=CONTROLLER, encoding="protobuf", data=data)
    return schema, message_factory.GetMessageClass(pool.FindMessageTypeByName(CONTROLLER))
