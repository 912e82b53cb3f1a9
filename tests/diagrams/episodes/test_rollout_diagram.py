"""How the closed loop is wired and shown, and which worlds it refuses."""

import base64
import re
from dataclasses import replace

import cv2
import pytest
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.primitives import VectorLogSink

from diagrams.episodes.compatibility import facts, require_trained_for
from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import World
from diagrams.world.station import FILM
from models.errors import InputError

CAN = (0.555, -0.041)


def test_diagram_without_the_camera_of_the_scene_is_wired(rollout):
    names = {system.get_name() for system in rollout.diagram.GetSystems() if not isinstance(system, VectorLogSink)}
    loop = {"station", "switched_controller", "acceleration_limit", "clearance_filter", "disturbance", "can_mover"}
    assert names == loop | {"requirements", "logged"}
    wires = {
        f"{source.get_name()}.{source.get_output_port(out).get_name()} -> "
        f"{target.get_name()}.{target.get_input_port(into).get_name()}"
        for (target, into), (source, out) in rollout.diagram.connection_map().items()
        if target.get_name() in names - {"logged"}
    }
    assert wires == {
        "station.rgb_image -> switched_controller.rgb_image",
        "station.posture -> switched_controller.posture",
        "station.finger_gap -> switched_controller.finger_gaps",
        "switched_controller.desired_posture -> acceleration_limit.desired_posture",
        "switched_controller.measured_posture -> acceleration_limit.posture",
        "switched_controller.alpha -> acceleration_limit.alpha",
        "acceleration_limit.limited_posture -> clearance_filter.desired_posture",
        "switched_controller.measured_posture -> clearance_filter.posture",
        "switched_controller.alpha -> clearance_filter.alpha",
        "clearance_filter.filtered_posture -> disturbance.desired_posture",
        "station.approach_distance -> disturbance.trigger",
        "disturbance.disturbed_posture -> station.desired_posture",
        "disturbance.ticks_since_onset -> can_mover.ticks_since_onset",
        "can_mover.can_place -> station.can_place",
        # What watches; none of its outputs goes into the loop.
        "switched_controller.alpha -> requirements.alpha",
        "disturbance.active -> requirements.active",
        "switched_controller.measured_posture -> requirements.posture",
        "clearance_filter.filtered_posture -> requirements.desired_posture",
        "station.query_object -> requirements.query_object",
    }


@pytest.mark.parametrize(("resumption", "resets"), [("reset", True), ("imagined", False)])
def test_the_world_says_how_the_network_comes_back(world, encoder, policy, resumption, resets):
    controller = Rollout(replace(world, resumption=resumption), encoder, policy).controller
    assert controller.HasSubsystemNamed("home_reset") is resets


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda w: setattr(w.timing, "period", 0.2), r"period is 0.2, the network was trained with 0.1"),
        (lambda w: setattr(w, "initial_joints_deg", [0.0] * 7), r"initial posture is .*, the network was trained with"),
        (lambda w: setattr(w, "opening", 0.07), r"initial posture is .*0.07.*, the network was trained with .*0.08"),
        (lambda w: setattr(w, "closed_opening", 0.02), r"closed opening is 0.02, the network was trained with 0.03"),
        (lambda w: setattr(w.camera, "width", 224), r"camera is .*224.* trained with .*112"),
        (lambda w: setattr(w.camera, "field_of_view_deg", 50.0), r"camera is .*50.* trained with .*43"),
    ],
)
def test_another_world_than_the_trained_one_is_refused(encoder, policy, change, named):
    world = World()
    change(world)
    with pytest.raises(InputError, match=named):
        Rollout(world, encoder, policy)


def test_a_network_that_was_trained_in_another_world_is_accepted_there(encoder, policy, monkeypatch):
    world = World()
    world.timing.period = 0.2
    monkeypatch.setattr(policy, "metadata", {"world": facts(world)}, raising=False)
    require_trained_for(world, policy)
    with pytest.raises(InputError, match=r"period is 0.1, the network was trained with 0.2"):
        require_trained_for(World(), policy)


def test_replay_and_film_are_written(world, encoder, policy, tmp_path):
    film = tmp_path / "film.mp4"
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    rollout = Rollout(world, encoder, policy, meshcat=meshcat, video=film)
    meshcat.StartRecording(set_visualizations_while_recording=False)
    policy.learn(Episode(0, CAN, "left"))
    rollout.run(Episode(0, CAN, "left"), time_limit=0.5)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    rollout.video.Save()
    reader = cv2.VideoCapture(str(film))
    size = [reader.get(what) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS)]
    assert size == [FILM[0], FILM[1], 10.0]
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == 5
    page = meshcat.StaticHtml()
    # What the page replays is inside it, packed.
    packed = b"".join(base64.b64decode(part) for part in re.findall(r"base64,([A-Za-z0-9+/=]+)", page))
    assert b"set_animation" in packed
    assert b"can_to_pick" in packed
    # What the network imagines and recalls, and alpha, move in it too.
    for path in (b"/drake/ghost/arm/link_7", b"/drake/recall/10", b"/drake/alpha/10"):
        assert path in packed, path
    assert "http://" not in page.split("<body", 1)[0].replace("http://www.w3.org", "")
