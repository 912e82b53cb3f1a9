"""Rollout: the whole system as one root Diagram, built once, that runs episode after episode on fresh contexts."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, System

from diagrams.episodes.calibration import RECALL, Calibration, stored_calibration
from diagrams.episodes.compatibility import require_trained_for
from diagrams.episodes.episode import DIVERGED, Episode, Outcome
from diagrams.episodes.narrator import Narrator
from diagrams.episodes.record import ARRAYS, PICTURE_EVERY, Record
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
        station, controller, period = self.station, self.controller, world.timing.period
        disturbance = self.disturbance = Disturbance(posture_size=policy.posture_size, period=period)
        builder.AddNamedSystem("disturbance", disturbance)
        self.can_mover = builder.AddNamedSystem("can_mover", CanMover(station, disturbance, period))
        builder.Connect(station.GetOutputPort("rgb_image"), controller.GetInputPort("rgb_image"))
        builder.Connect(station.GetOutputPort("posture"), controller.GetInputPort("posture"))
        builder.Connect(controller.GetOutputPort("desired_posture"), disturbance.GetInputPort("desired_posture"))
        builder.Connect(station.GetOutputPort("approach_distance"), disturbance.GetInputPort("trigger"))
        builder.Connect(disturbance.GetOutputPort("disturbed_posture"), station.GetInputPort("desired_posture"))
        self.video = None
        if video is not None:
            from pydrake.visualization import VideoWriter

            self.video = builder.AddSystem(VideoWriter(filename=str(video), fps=1 / period, backend="cv2"))
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
        started, period = time.perf_counter(), self.world.timing.period
        monitor = self.prepare(episode, calibration)
        narrator = Narrator(monitor, on_event)
        rows: dict[str, list] = {name: [] for name in (*ARRAYS, "at_home")}
        success = diverged = cut = False
        limit, extra, k = round(time_limit / period), 0, 0
        while k < limit + extra and not success and not cut:
            if (tick := self._tick(k, pictures)) is None:
                diverged = True  # what came before is kept
                break
            posture, cans, active = tick["posture"], tick["can_poses"], tick["active"]
            tick["at_home"] = bool(monitor.home(posture))
            for name, value in tick.items():
                rows[name].append(value)
            taken = self.can_mover.moved(self.simulator.get_context())
            narrator.see(k * period, posture, tick["alpha"], active, taken, cans)
            success = monitor.success(cans, posture) and not active
            if not active and any(rows["active"]):
                extra = self._switching(episode, rows).ticks_disturbed
            if until == "switching":
                cut = self._switching(episode, rows).decided
            elif until == "detection":
                cut = any(rows["active"][:-DETECTION_TICKS]) and not any(rows["active"][-DETECTION_TICKS:])
            k += 1
            if on_tick is not None:
                on_tick(k)
        unfinished = "the simulation diverged" if diverged else f"{until} decided" if cut else "time is up"
        narrator.say((k - 1) * period, "task done" if success else unfinished)
        record = Record(events=narrator.events, **{name: np.array(rows[name]) for name in ARRAYS})
        outcome = self._outcome(episode, monitor, record, self._switching(episode, rows), success, diverged)
        if until != "task":
            outcome.success = None
            if outcome.failure != DIVERGED:
                outcome.failure = outcome.paper_switch_success = None
        outcome.wall_seconds = time.perf_counter() - started
        outcome.realtime_factor = outcome.sim_seconds / outcome.wall_seconds
        return outcome, record

    def _tick(self, k: int, pictures: bool) -> dict[str, Any] | None:
        """Runs tick k; what a Record keeps of it, or None if the physics diverged."""
        period, get = self.world.timing.period, self._output
        # At the tick, before its update: the features that the update will use, from one rendering for both.
        if not self._advance(k * period):
            return None
        features = get(self.controller, "features").copy()
        # In the middle of the tick: every other output holds from the update to the next one.
        if not self._advance((k + 0.5) * period):
            return None
        posture = get(self.controller, "posture_history")[: self.policy.posture_size]
        tick = {name: get(self.controller, name).copy() for name in RECORDED} | {
            "time": k * period,
            "posture": self.policy.scaling.unscale(posture),
            "alpha": float(get(self.controller, "alpha")[0]),
            "active": bool(get(self.disturbance, "active")[0] > 0.5),
            "can_poses": get(self.station, "can_poses").copy(),
            "features": features,
        }
        if pictures and k % PICTURE_EVERY == 0:
            tick |= {"picture_ticks": k, "pictures": get(self.station, "rgb_image").data[:, :, :3].copy()}
        return tick

    def _output(self, system: System, port: str):
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.simulator.get_context()))

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

    def _switching(self, episode: Episode, rows: dict[str, list]) -> Switching:
        alpha, active, at_home = (np.array(rows[name]) for name in ("alpha", "active", "at_home"))
        return Switching.of(alpha, active, at_home, episode.disturbance.kind != "none", self.world.timing.period)

    def _outcome(
        self,
        episode: Episode,
        monitor: TaskMonitor,
        record: Record,
        switching: Switching,
        success: bool,
        diverged: bool,
    ) -> Outcome:
        period, kind = self.world.timing.period, episode.disturbance.kind
        failure, switch_failure, as_in_paper = None, switching.failure, switching.as_in_paper
        if diverged and switch_failure in (None, "not disturbed"):
            failure, switch_failure, as_in_paper = DIVERGED, DIVERGED, False
        elif not success:  # what went wrong first
            first = switch_failure if switch_failure != "not disturbed" else None
            failure = first or monitor.failure(record.can_poses, record.posture)

        def seconds(a: int | None, b: int | None) -> float | None:
            return None if a is None or b is None else (b - a) * period

        return Outcome(
            seed=episode.seed,
            rnn=episode.rnn,
            detector=episode.detector,
            disturbance=kind,
            can_xy=(float(episode.can_xy[0]), float(episode.can_xy[1])),
            vacant=episode.vacant,
            picked=bool(lifted(record.can_poses).any()),
            placed=monitor.placed(record.can_poses[-1]),
            home=bool(monitor.home(record.posture[-1])),
            success=success,
            switched=bool((record.alpha >= GUARD).any()),
            detection_delay_s=seconds(switching.onset, switching.detected),
            false_switches=switching.false_switches,
            returned=None if kind == "none" else switching.home is not None,
            resumed=None if kind == "none" else switching.resumed is not None,
            switch_success=switch_failure is None,
            paper_switch_success=as_in_paper,
            alpha_max_before=switching.alpha_max_before,
            return_s=seconds(switching.end, switching.home),
            resume_s=seconds(switching.home, switching.resumed),
            failure=failure,
            switch_failure=switch_failure,
            sim_seconds=len(record.time) * period,
            weights_hash=self.policy.hash,
        )
