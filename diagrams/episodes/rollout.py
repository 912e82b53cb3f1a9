"""Rollout: the whole system as one root Diagram, built once, that runs episode after episode on fresh contexts."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, System

from diagrams.episodes.calibration import RECALL, Calibration, stored_calibration
from diagrams.episodes.compatibility import require_trained_for
from diagrams.episodes.episode import DIVERGED, Episode, Outcome
from diagrams.episodes.narrator import Narrator
from diagrams.episodes.record import PICTURE_EVERY, Record
from diagrams.episodes.switching import DETECTION_TICKS, GUARD, Switching, Until
from diagrams.world.can_mover import CanMover
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, other_spot
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import TIME_LIMIT, TaskMonitor, lifted
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.disturbance import Disturbance
from systems.switched_controller import SwitchedController

# Outputs of the controller that are recorded in the middle of each tick, under their own names.
RECORDED = ("rnn_step", "regulator_step", "desired_posture", "errors", "hidden_state", "predicted_features")


class Rollout:
    """Station, controller and disturbance, wired as systems/README.md says."""

    def __init__(
        self,
        world: World,
        encoder,
        policy,
        detector: System | None = None,
        calibration: Calibration | None = None,
        meshcat=None,
        video: Path | None = None,
    ):
        """
        Args:
            encoder, policy: see models/inference.py.
            detector, calibration: see systems/detector.py; None: the recall, with the policy's own calibration.
            meshcat: where the run is shown.
            video: an .mp4 to write, finished by `self.video.Save()`.

        Raises InputError for networks, camera, world and regulator that do not fit together.
        """
        require_trained_for(world, policy)
        self.world, self.policy = world, policy
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, film_camera=video is not None))
        lower, upper, speed = controller_limits(self.station)
        if detector is None:
            detector = DETECTORS[RECALL].build(policy, ARM_JOINTS, {})
            calibration = calibration or stored_calibration(RECALL, policy, Path())
        self.calibration = calibration
        try:
            self.controller = SwitchedController(
                encoder,
                policy,
                detector,
                joints=ARM_JOINTS,
                regulator_Q=world.regulator.state_weight,
                regulator_R=world.regulator.input_weight,
                joint_lower=lower,
                joint_upper=upper,
                speed_limits=speed,
                period=world.timing.period,
                image_width=world.camera.width,
                image_height=world.camera.height,
            )
        except ValueError as error:
            raise InputError(f"the controller cannot be built: {error}") from error
        builder.AddNamedSystem("switched_controller", self.controller)
        self.disturbance = builder.AddNamedSystem(
            "disturbance", Disturbance(posture_size=policy.posture_size, period=world.timing.period)
        )
        station, controller, disturbance = self.station, self.controller, self.disturbance
        self.can_mover = builder.AddNamedSystem("can_mover", CanMover(station, disturbance, world.timing.period))
        builder.Connect(station.GetOutputPort("rgb_image"), controller.GetInputPort("rgb_image"))
        builder.Connect(station.GetOutputPort("posture"), controller.GetInputPort("posture"))
        builder.Connect(controller.GetOutputPort("desired_posture"), disturbance.GetInputPort("desired_posture"))
        builder.Connect(station.GetOutputPort("approach_distance"), disturbance.GetInputPort("trigger"))
        builder.Connect(disturbance.GetOutputPort("disturbed_posture"), station.GetInputPort("desired_posture"))
        self.video = None
        if video is not None:
            from pydrake.visualization import VideoWriter

            self.video = builder.AddSystem(VideoWriter(filename=str(video), fps=1 / world.timing.period, backend="cv2"))
            builder.Connect(station.GetOutputPort("film_image"), self.video.get_input_port())
        if meshcat is not None:
            from pydrake.geometry import MeshcatVisualizer

            # The scene graph is inside the station, where ApplyVisualizationConfig does not look.
            MeshcatVisualizer.AddToBuilder(builder, station.GetOutputPort("query_object"), meshcat)
        self.diagram = builder.Build()
        self.diagram.set_name("pick_place")
        self.simulator = Simulator(self.diagram)
        self.simulator.set_monitor(self._intervene)

    def _intervene(self, _) -> EventStatus:
        self.can_mover.act(self.simulator.get_mutable_context())
        return EventStatus.DidNothing()

    def prepare(self, episode: Episode, calibration: Calibration | None = None) -> TaskMonitor:
        """Puts a fresh Context for `episode` into the simulator; `calibration` instead of the constructor's."""
        station, given = self.station, episode.disturbance
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        meter = station.approach_meter
        meter.set_subtask(meter.GetMyMutableContextFromRoot(context), given.subtask)
        self.disturbance.set_parameters(self.disturbance.GetMyMutableContextFromRoot(context), given)
        if (used := calibration or self.calibration) is None:
            raise InputError("the detector has no calibration: give one, or run diagrams/baselines.py")
        self.controller.set_calibration(context, used.reference_errors, used.beta, used.gamma)
        self.can_mover.set_place(self.can_mover.GetMyMutableContextFromRoot(context), given.can_moved_to)
        self.simulator.Initialize()
        goal, neighbour = station.spot(episode.vacant), station.spot(other_spot(episode.vacant))
        return TaskMonitor(goal, neighbour, self.world.initial_posture)

    def run(
        self,
        episode: Episode,
        on_event: Callable[[float, str], None] | None = None,
        on_tick: Callable[[int], None] | None = None,
        until: Until = "task",
        pictures: bool = False,
        time_limit: float = TIME_LIMIT,
        calibration: Calibration | None = None,
    ) -> tuple[Outcome, Record]:
        """Runs `episode` to success, to its time limit, or to what `until` says; its ticks are those of the whole run.

        Args:
            on_event: is told (s, what happened); on_tick: is told the number of ticks so far.
            pictures: keep what the camera sees every PICTURE_EVERY ticks.
            time_limit: s, plus the time disturbed.
            calibration: see `prepare`.
        """
        started = time.perf_counter()
        monitor = self.prepare(episode, calibration)
        period = self.world.timing.period
        context = self.simulator.get_mutable_context()
        controller, disturbance = (s.GetMyContextFromRoot(context) for s in (self.controller, self.disturbance))
        get = self.controller.GetOutputPort
        rows: dict[str, list] = defaultdict(list, {"picture_ticks": [], "pictures": []})
        narrator = Narrator(monitor, on_event)
        size, scaling = self.policy.posture_size, self.policy.scaling
        success = diverged = cut = False
        disturbed = episode.disturbance.kind != "none"
        limit, extra, k = round(time_limit / period), 0, 0
        switching: Switching | None = None
        while k < limit + extra and not success and not cut:
            # At the tick, before its update: the features that the update will use, from one rendering for both.
            diverged = not self._advance(k * period)
            if not diverged:
                features = get("features").Eval(controller).copy()
                # In the middle of the tick: every other output holds from the update to the next one.
                diverged = not self._advance((k + 0.5) * period)
            if diverged:
                break  # what came before is kept
            posture = scaling.unscale(get("posture_history").Eval(controller)[:size])
            cans = self._station_output("can_poses").copy()
            alpha = float(get("alpha").Eval(controller)[0])
            active = bool(self.disturbance.GetOutputPort("active").Eval(disturbance)[0] > 0.5)
            row = dict(posture=posture, alpha=alpha, active=active, can_poses=cans, features=features)
            row |= {name: get(name).Eval(controller).copy() for name in RECORDED}
            row["at_home"] = bool(monitor.home(posture))
            if pictures and k % PICTURE_EVERY == 0:
                row |= {"picture_ticks": k, "pictures": self._station_output("rgb_image").data[:, :, :3].copy()}
            for name, value in row.items():
                rows[name].append(value)
            narrator.see(k * period, posture, alpha, active, self.can_mover.moved(context), cans)
            if disturbed and not active and any(rows["active"]) and (switching is None or switching.resumed is None):
                switching = self._switching(rows, disturbed)
                extra = switching.ticks_disturbed
            success = monitor.success(cans, posture) and not active
            k += 1
            if until == "switching":
                cut = self._switching(rows, disturbed).decided
            elif until == "detection":
                cut = any(rows["active"][:-DETECTION_TICKS]) and not any(rows["active"][-DETECTION_TICKS:])
            if on_tick is not None:
                on_tick(k)
        switching = self._switching(rows, disturbed)
        ends = (
            (success, "task done"),
            (diverged, "the simulation diverged"),
            (cut, f"{until} decided"),
            (True, "time is up"),
        )
        narrator.say((k - 1) * period, next(words for came, words in ends if came))
        rows.pop("at_home", None)
        arrays = {name: np.array(values) for name, values in rows.items()}
        record = Record(time=period * np.arange(k), events=narrator.events, **arrays)
        outcome = self._outcome(episode, monitor, record, switching, success)
        if until != "task":
            outcome.success = outcome.failure = outcome.paper_switch_success = None
        if diverged and switching.failure in (None, "not disturbed"):
            outcome.failure = outcome.switch_failure = DIVERGED
            outcome.switch_success = outcome.paper_switch_success = False
        outcome.wall_seconds = time.perf_counter() - started
        outcome.realtime_factor = outcome.sim_seconds / outcome.wall_seconds
        return outcome, record

    def _station_output(self, port: str):
        return self.station.GetOutputPort(port).Eval(self.station.GetMyContextFromRoot(self.simulator.get_context()))

    def _advance(self, seconds: float) -> bool:
        """To that time; False if the physics diverged: something hard was squeezed between hard things."""
        try:
            self.simulator.AdvanceTo(seconds)
        except RuntimeError as error:
            if "non-finite" not in str(error):
                raise
            return False
        # The last step may have overflowed, and Drake ends the process that asks for a pose then.
        plant = self.station.plant
        state = plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(self.simulator.get_context()))
        return bool(np.isfinite(state).all())

    def _switching(self, rows: dict[str, list], disturbed: bool) -> Switching:
        alpha, active, at_home = (np.array(rows[name]) for name in ("alpha", "active", "at_home"))
        return Switching.of(alpha, active, at_home, disturbed, self.world.timing.period)

    def _outcome(
        self, episode: Episode, monitor: TaskMonitor, record: Record, switching: Switching, success: bool
    ) -> Outcome:
        period = self.world.timing.period
        cans, posture = record.can_poses[-1], record.posture[-1]
        disturbed = episode.disturbance.kind != "none"
        failure = None
        if not success:  # what went wrong first
            first = switching.failure if switching.failure != "not disturbed" else None
            failure = first or monitor.failure(record.can_poses, record.posture)

        def seconds(a: int | None, b: int | None) -> float | None:
            return None if a is None or b is None else (b - a) * period

        return Outcome(
            seed=episode.seed,
            rnn=episode.rnn,
            detector=episode.detector,
            disturbance=episode.disturbance.kind,
            can_xy=(float(episode.can_xy[0]), float(episode.can_xy[1])),
            vacant=episode.vacant,
            picked=bool(lifted(record.can_poses).any()),
            placed=monitor.placed(cans),
            home=bool(monitor.home(posture)),
            success=success,
            switched=bool((record.alpha >= GUARD).any()),
            detection_delay_s=seconds(switching.onset, switching.detected),
            false_switches=switching.false_switches,
            returned=switching.home is not None if disturbed else None,
            resumed=switching.resumed is not None if disturbed else None,
            switch_success=switching.failure is None,
            paper_switch_success=switching.as_in_paper,
            alpha_max_before=switching.alpha_max_before,
            return_s=seconds(switching.end, switching.home),
            resume_s=seconds(switching.home, switching.resumed),
            failure=failure,
            switch_failure=switching.failure,
            sim_seconds=len(record.time) * period,
            weights_hash=self.policy.hash,
        )
