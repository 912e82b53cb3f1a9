"""The camera of the station: what it sees, and the renderer."""

import os
import subprocess
import sys

import numpy as np
import pytest
from pydrake.geometry import Role

from diagrams.world import station as station_module
from diagrams.world.configuration import Camera, World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation, controller_limits
from models.command_line import ROOT
from models.errors import InputError
from tests.diagrams.world.station_runs import picture, red_pixels


def test_can_moves_in_the_picture_as_it_moves_on_the_desk(station):
    away = np.array([red_pixels(picture(station, (x, 0.0))).mean(axis=0) for x in np.linspace(0.44, 0.62, 4)])
    aside = np.array([red_pixels(picture(station, (0.53, y))).mean(axis=0) for y in np.linspace(-0.09, 0.09, 4)])
    assert np.all(np.diff(away[:, 0]) > 5)  # towards the camera: down in the picture, 6 cm a step
    assert np.all(np.diff(aside[:, 1]) > 5)  # to the arm's left: right in the picture


def test_corners_of_the_grid_are_well_inside_the_picture(station, world):
    empty = picture(station, (-3.0, 0.0))
    lower, upper = world.grid.bounds
    for x in (lower[0], upper[0]):
        for y in (lower[1], upper[1]):
            image = picture(station, (x, y))
            assert image.shape == (112, 112, 3)
            changed = np.argwhere(np.abs(image - empty).max(axis=2) > 8)
            assert changed.min() >= 3
            assert changed.max() <= 108
            assert len(red_pixels(image)) > 20


def test_picture_shows_which_spot_is_vacant(station):
    assert np.count_nonzero(np.abs(picture(station, vacant="left") - picture(station, vacant="right")) > 30) > 100


def test_a_larger_picture_can_be_asked_for():
    station = PickPlaceStation(World(camera=Camera(width=224, height=224)))
    assert picture(station).shape == (224, 224, 3)


def test_the_renderer_holds_no_shape_that_the_camera_can_never_see(station):
    """What is for people alone says so in its SDF file (perception_properties): each shape drawn takes its time."""
    scene, plant = station.GetSubsystemByName("camera_scene"), station.plant
    inspector, rng = scene.model_inspector(), np.random.default_rng(0)
    unseen = set(inspector.GetAllGeometryIds(Role.kPerception))
    assert unseen

    def seen(joints, without=None):
        context = station.CreateDefaultContext()
        plant.SetPositions(plant.GetMyMutableContextFromRoot(context), station.arm, joints)
        if without is not None:
            scene_context = scene.GetMyMutableContextFromRoot(context)
            scene.RemoveRole(scene_context, plant.get_source_id(), without, Role.kPerception)
        return station.GetOutputPort("rgb_image").Eval(context).data.copy()

    lower, upper, _ = controller_limits(station)
    random = (rng.uniform(lower, upper)[:ARM_JOINTS] for _ in range(100))
    for joints in (station.world.initial_posture[:ARM_JOINTS], *random):
        whole = seen(joints)
        unseen -= {shape for shape in unseen if not np.array_equal(whole, seen(joints, shape))}
        if not unseen:
            break
    assert not {inspector.GetName(shape) for shape in unseen}


def test_no_egl_is_a_clear_error(world, monkeypatch):
    def fail(params):
        raise RuntimeError("Unable to eglInitialize")

    monkeypatch.setattr(station_module, "MakeRenderEngineVtk", fail)
    with pytest.raises(InputError, match=r"EGL is not usable here .*libegl1 libgl1"):
        PickPlaceStation(world)


def test_elsewhere_than_on_linux_no_egl_is_asked_for(world, monkeypatch):
    asked = []
    monkeypatch.setattr(station_module.sys, "platform", "darwin")
    monkeypatch.setattr(station_module, "_require_egl_device", lambda: asked.append("EGL"))
    make = station_module.MakeRenderEngineVtk
    monkeypatch.setattr(
        station_module, "MakeRenderEngineVtk", lambda params: asked.append(params.backend) or make(params)
    )
    PickPlaceStation(world)
    assert asked == [""]


def test_egl_without_a_device_is_a_clear_error():
    """libEGL alone initialises, and the first picture would end the process."""
    code = (
        "from diagrams.world.configuration import World; from diagrams.world.station import PickPlaceStation; "
        "PickPlaceStation(World())"
    )
    environment = os.environ | {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent.json"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert (
        "InputError: the camera cannot render without a display: EGL is not usable here (no EGL device)" in done.stderr
    )
