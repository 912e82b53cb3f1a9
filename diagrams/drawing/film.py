"""A run as a short film: the arm, and as a ghost the posture that the network imagines."""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    PerceptionProperties,
    RenderCameraCore,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.systems.sensors import CameraInfo, RgbdSensor

from diagrams.episodes.record import Record
from diagrams.episodes.switching import GUARD
from diagrams.world.configuration import World
from diagrams.world.ghost import MODELS, TRANSLUCENT
from diagrams.world.names import ARM_JOINTS, CAN_RADIUS, CANS
from diagrams.world.station import RENDERER, add_models, can_body, renderer
from diagrams.world.task import held
from models.files.container import whole_file

SIZE, FIELD_OF_VIEW_DEG = (560, 420), 42.0  # pixels; vertical
AROUND = 1.5  # s before the disturbance and after the network has the arm again
QUALITY = 60  # of a WebP
GREEN, RED, ORANGE = (47, 133, 90), (197, 48, 48), (221, 107, 32)


def save_film(record: Record, world: World, path: Path) -> None:
    """Writes `film_frames` to `path`, see FILM_FORMATS, in the time of the run."""
    frames = [Image.fromarray(frame) for frame in film_frames(record, world)]
    length = round(1000 * world.timing.period)
    options = {"quality": QUALITY, "method": 4} if path.suffix == ".webp" else {"optimize": True}
    with whole_file(path) as partial:
        frames[0].save(partial, save_all=True, append_images=frames[1:], duration=length, loop=0, **options)


def film_frames(record: Record, world: World) -> list[np.ndarray]:
    """uint8 (h, w, 3) each: the ticks around the disturbance of `record`, or all of an undisturbed one.

    `world`: that the record was made in. Raises InputError without a renderer.
    """
    stage, frames = _Stage(world), []
    imagined = record.posture + record.rnn_step + record.regulator_step  # m^R_{k+1}
    for k in _ticks(record, world.timing.period):
        gap = record.posture[k, -1]
        if held(record.can_poses[k], record.posture[k], world.opening):
            gap = max(gap, 2 * CAN_RADIUS)  # the closed fingers stall on it
        picture = stage.picture(np.append(record.posture[k, :-1], gap), imagined[max(k - 1, 0)], record.can_poses[k])
        frames.append(_captioned(picture, record.alpha[k], bool(record.active[k] > 0.5)))
    return frames


def _ticks(record: Record, period: float) -> range:
    active, n = np.flatnonzero(record.active > 0.5), len(record.time)
    if not len(active):
        return range(n)
    away = np.flatnonzero(record.alpha >= GUARD)
    last, around = max(active[-1], away[-1] if len(away) else 0), round(AROUND / period)
    return range(max(0, active[0] - around), min(n, last + around + 1))


def _captioned(picture: np.ndarray, alpha: float, active: bool) -> np.ndarray:
    """With a bar as long as alpha, and a word for who moves the arm."""
    height, width = picture.shape[:2]
    colour = RED if alpha >= GUARD else GREEN
    words = "disturbed" if active else "the LQR brings it home" if alpha >= GUARD else "the network moves the arm"
    made = np.ascontiguousarray(picture)
    cv2.rectangle(made, (0, height - 30), (width, height), (255, 255, 255), -1)
    cv2.rectangle(made, (70, height - 22), (180, height - 10), (225, 225, 225), -1)
    cv2.rectangle(made, (70, height - 22), (70 + round(110 * alpha), height - 10), colour, -1)
    for text, x, ink in (("alpha", 12, (40, 40, 40)), (words, 200, ORANGE if active else colour)):
        cv2.putText(made, text, (x, height - 11), cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, 1, cv2.LINE_AA)
    return made


class _Stage:
    """The scene and the ghost, in postures that are given, seen by the camera for people."""

    def __init__(self, world: World):
        builder, self._scene = DiagramBuilder(), SceneGraph()
        builder.AddSystem(self._scene)
        self._scene.AddRenderer(RENDERER, renderer())
        self._plants: list[MultibodyPlant] = []
        for names in (None, MODELS):
            plant = MultibodyPlant(0.0)
            plant.RegisterAsSourceForSceneGraph(self._scene)
            add_models(plant, world, names)
            plant.Finalize()
            poses = builder.AddSystem(MultibodyPositionToGeometryPose(plant))
            builder.ExportInput(poses.get_input_port(), str(len(self._plants)))
            builder.Connect(poses.get_output_port(), self._scene.get_source_pose_port(plant.get_source_id()))
            self._plants.append(plant)
        self._make_translucent(self._plants[1])
        frame = self._plants[0].GetFrameByName("film_camera")
        body = self._plants[0].GetBodyFrameIdOrThrow(frame.body().index())
        info = CameraInfo(width=SIZE[0], height=SIZE[1], fov_y=np.deg2rad(FIELD_OF_VIEW_DEG))
        core = RenderCameraCore(RENDERER, info, ClippingRange(0.1, 5.0), RigidTransform())
        cameras = ColorRenderCamera(core), DepthRenderCamera(core, DepthRange(0.2, 4.0))
        self._camera = builder.AddSystem(RgbdSensor(body, frame.GetFixedPoseInBodyFrame(), *cameras))
        builder.Connect(self._scene.get_query_output_port(), self._camera.query_object_input_port())
        builder.ExportOutput(self._camera.color_image_output_port(), "picture")
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def _make_translucent(self, plant: MultibodyPlant) -> None:
        inspector, source = self._scene.model_inspector(), plant.get_source_id()
        properties = PerceptionProperties()
        properties.AddProperty("phong", "diffuse", Rgba(*TRANSLUCENT))
        for shape in inspector.GetAllGeometryIds(Role.kPerception):
            if inspector.BelongsToSource(shape, source):
                self._scene.RemoveRole(source, shape, Role.kPerception)
                self._scene.AssignRole(source, shape, properties)

    def picture(self, posture: np.ndarray, imagined: np.ndarray, can_poses: np.ndarray) -> np.ndarray:
        """uint8 (h, w, 3) of the arm at `posture`, the ghost at `imagined` (8,), the cans at `can_poses` (14,)."""
        for place, (plant, row) in enumerate(zip(self._plants, (posture, imagined), strict=True)):
            context = plant.CreateDefaultContext()
            plant.SetPositions(context, plant.GetModelInstanceByName("arm"), row[:ARM_JOINTS])
            plant.SetPositions(context, plant.GetModelInstanceByName("gripper"), [0.5 * row[-1]] * 2)
            if place == 0:
                for can, pose in zip(CANS, np.split(can_poses, 2), strict=True):
                    body = can_body(plant, can)
                    q = plant.GetPositions(context)
                    q[body.floating_positions_start() :][:7] = pose
                    plant.SetPositions(context, q)
            self._diagram.get_input_port(place).FixValue(self._context, plant.GetPositions(context))
        return self._diagram.get_output_port().Eval(self._context).data[:, :, :3].copy()
