"""Rollout: the whole system as one root Diagram, built once, that runs episode after episode on fresh contexts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from diagrams.episodes.calibration import Calibration, stored_calibration
from diagrams.episodes.episode import (
    DETECTION_TICKS,
    FALSE_ALARM,
    LIFTED,
    RESUMED,
    TIME_LIMIT,
    UPRIGHT_TOLERANCE,
    Episode,
    Outcome,
    Switching,
    TaskMonitor,
    Until,
    tilt,
)
from diagrams.world.scenario import SPOTS, World
from diagrams.world.station import ARM_JOINTS, CAN_HALF_HEIGHT, PickPlaceStation
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.disturbance import Disturbance
from systems.switched_controller import SwitchedController

# After the disturbance began; by then the arm stands still.
CAN_TAKEN_TICKS = 5
# The recall of the joint angles is judged, not that of the fingers: under alpha = 1 they keep their command whatever the network goes through.
COMPONENT_WEIGHTS = np.append(np.ones(ARM_JOINTS), 0.0)


@dataclass
class Record:
    """One run, a row a tick (taken in the middle of the tick); angles rad, lengths m."""

    time: np.ndarray  # (n,) s, of the tick
    posture: np.ndarray  # (n, 8) m_k as sampled
    rnn_step: np.ndarray  # (n, 8) dm^R
    regulator_step: np.ndarray  # (n, 8) dm^L
    desired_posture: np.ndarray  # (n, 8) command
    alpha: np.ndarray  # (n,)
    errors: np.ndarray  # (n, N + 1) l_n / reference error
    hidden_state: np.ndarray  # (n, S)
    features: np.ndarray  # (n, 30)
    active: np.ndarray  # (n,) disturbance under way
    can_poses: np.ndarray  # (n, 14)
    squared_errors: np.ndarray  # (n, N + 1) l_n, scaled postures
    events: list[tuple[float, str]]  # (s, what happened)


def controller_limits(station: PickPlaceStation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper limits of the command (8,) and its largest speed (8,), from the model; rad, m, /s."""
    joints = [station.plant.GetJointByName(f"joint_{j + 1}") for j in range(ARM_JOINTS)]
    finger = station.plant.GetJointByName("left_finger_joint")
    lower = [j.position_lower_limit() for j in joints] + [0.0]
    upper = [j.position_upper_limit() for j in joints] + [2 * finger.position_upper_limit()]
    speed = [j.velocity_upper_limit() for j in joints] + [2 * finger.velocity_upper_limit()]
    return np.array(lower), np.array(upper), np.array(speed)


class Rollout:
    """Station, controller and disturbance, wired; see architecture in the README."""

    def __init__(
        self,
        world: World,
        encoder,
        policy,
        detector=None,
        calibration: Calibration | None = None,
        meshcat=None,
        video: Path | None = None,
    ):
        """`encoder`, `policy`: see models/inference.py; `detector`, `calibration`: those of the policy's recall where None; `meshcat`: to show
        the run in; `video`: an .mp4 to write, finished by `self.video.Save()`. Raises InputError for networks, camera and regulator that do not
        fit together."""
        self.world, self.policy = world, policy
        detector = detector or DETECTORS["recall"].build(policy, ARM_JOINTS, {})
        self.calibration = calibration or stored_calibration("recall", policy, Path())
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, film_camera=video is not None))
        lower, upper, speed = controller_limits(self.station)
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
        except ValueError as error:  # networks, camera and regulator that do not fit together
            raise InputError(f"the controller cannot be built: {error}") from error
        builder.AddNamedSystem("switched_controller", self.controller)
        self.disturbance = builder.AddNamedSystem(
            "disturbance", Disturbance(posture_size=policy.posture_size, period=world.timing.period)
        )
        station, controller, disturbance = self.station, self.controller, self.disturbance
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

    def prepare(self, episode: Episode) -> TaskMonitor:
        """Puts a fresh Context for `episode` into the simulator."""
        world, station, draw = self.world, self.station, episode.disturbance
        self.simulator.reset_context(self.diagram.CreateDefaultContext())
        context = self.simulator.get_mutable_context()
        calibration = self.calibration
        self.controller.set_calibration(context, calibration.reference_errors, calibration.beta, calibration.gamma)
        station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        meter = station.approach_meter
        meter.set_subtask(meter.GetMyMutableContextFromRoot(context), draw.subtask)
        target = None if draw.target_joints is None else np.append(draw.target_joints, np.nan)
        self.disturbance.set_disturbance(
            self.disturbance.GetMyMutableContextFromRoot(context), draw.kind, target, draw.level, draw.hold_ticks
        )
        self.simulator.Initialize()
        neighbour = station.spot(next(s for s in SPOTS if s != episode.vacant))
        return TaskMonitor(station.spot(episode.vacant), neighbour, world.initial_posture)

    def run(
        self,
        episode: Episode,
        on_event: Callable[[float, str], None] | None = None,
        on_tick: Callable[[int], None] | None = None,
        until: Until = "task",
    ) -> tuple[Outcome, Record]:
        """Runs `episode` to success or to its time limit, or to what `until` says; its ticks are those of the whole run."""
        started = time.perf_counter()
        monitor = self.prepare(episode)
        period = self.world.timing.period
        context = self.simulator.get_mutable_context()
        contexts = [s.GetMyContextFromRoot(context) for s in (self.station, self.controller, self.disturbance)]
        station, controller, disturbance = contexts
        rows: dict[str, list] = {name: [] for name in ("posture", "alpha", "active", "can_poses", "at_home")}
        names = ("rnn_step", "regulator_step", "desired_posture", "errors", "hidden_state", "features")
        logs: dict[str, list] = {name: [] for name in names}
        squared: list[np.ndarray] = []
        narrator = _Narrator(monitor, CAN_HALF_HEIGHT, on_event)
        size, success, taken, diverged, cut = self.policy.posture_size, False, False, False, False
        scaling, k = self.policy.scaling, 0
        disturbed = episode.disturbance.kind != "none"
        limit = round(TIME_LIMIT / period)
        extra, switching = 0, None
        while k < limit + extra and not success and not cut:
            get = self.controller.GetOutputPort
            # At the tick, before its update: the features that the update will use, from one rendering for both.
            diverged = not self._advance(k * period)
            if not diverged:
                features = get("features").Eval(controller).copy()
                # In the middle of the tick: every other output holds from the update to the next one.
                diverged = not self._advance((k + 0.5) * period)
            if diverged:
                break  # what came before is kept
            logs["features"].append(features)
            history = get("posture_history").Eval(controller).reshape(-1, size)
            recalled = get("recalled_postures").Eval(controller).reshape(-1, size)
            posture = scaling.unscale(history[0])
            squared.append(np.average((history - recalled) ** 2, axis=1, weights=COMPONENT_WEIGHTS))
            cans = self.station.GetOutputPort("can_poses").Eval(station).copy()
            alpha = float(get("alpha").Eval(controller)[0])
            active = bool(self.disturbance.GetOutputPort("active").Eval(disturbance)[0] > 0.5)
            for name, row in zip(rows, (posture, alpha, active, cans, monitor.home(posture)), strict=True):
                rows[name].append(row)
            for name in names:
                if name != "features":
                    logs[name].append(get(name).Eval(controller).copy())
            narrator.see(k * period, posture, alpha, active, cans)
            if episode.disturbance.can_moved_to is not None and not taken and sum(rows["active"]) == CAN_TAKEN_TICKS:
                self.station.place_can(context, np.asarray(episode.disturbance.can_moved_to))
                taken = True
                narrator.say(k * period, "the can is taken from the hand and put elsewhere on the desk")
            if (
                disturbed
                and (switching is None or switching.resumed is None)
                and rows["active"][-1] is False
                and any(rows["active"])
            ):
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
        arrays = {name: np.array(values) for name, values in {**rows, **logs}.items()}
        arrays.pop("at_home")
        record = Record(time=period * np.arange(k), squared_errors=np.array(squared), events=narrator.events, **arrays)
        outcome = self._outcome(episode, monitor, record, switching, success)
        if until != "task":
            outcome.success = outcome.failure = outcome.paper_switch_success = None
        if diverged and switching.failure in (None, "not disturbed"):
            outcome.failure = outcome.switch_failure = "simulation diverged"
            outcome.switch_success = outcome.paper_switch_success = False
        outcome.wall_seconds = time.perf_counter() - started
        outcome.realtime_factor = outcome.sim_seconds / outcome.wall_seconds
        return outcome, record

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
        lifted = record.can_poses[:, 6] - CAN_HALF_HEIGHT > LIFTED
        disturbed = episode.disturbance.kind != "none"
        seconds = lambda a, b: None if a is None or b is None else (b - a) * period  # noqa: E731
        return Outcome(
            seed=episode.seed,
            rnn=episode.rnn,
            detector=episode.detector,
            disturbance=episode.disturbance.kind,
            can_xy=(float(episode.can_xy[0]), float(episode.can_xy[1])),
            vacant=episode.vacant,
            picked=bool(lifted.any()),
            placed=monitor.placed(cans),
            home=monitor.home(posture),
            success=success,
            switched=bool((record.alpha >= FALSE_ALARM).any()),
            detection_delay_s=seconds(switching.onset, switching.detected),
            false_switches=switching.false_switches,
            returned=switching.home is not None if disturbed else None,
            resumed=switching.resumed is not None if disturbed else None,
            switch_success=switching.failure is None,
            paper_switch_success=switching.as_in_paper,
            alpha_max_before=switching.alpha_max_before,
            return_s=seconds(switching.end, switching.home),
            resume_s=seconds(switching.home, switching.resumed),
            failure=None if success else self._failure(monitor, record, switching, bool(lifted.any())),
            switch_failure=switching.failure,
            sim_seconds=len(record.time) * period,
            weights_hash=self.policy.hash,
        )

    def _failure(self, monitor: TaskMonitor, record: Record, switching: Switching, picked: bool) -> str:
        """The kind of a failed task: what went wrong first."""
        if switching.failure not in (None, "not disturbed"):
            return str(switching.failure)
        cans = record.can_poses[-1]
        moved = np.abs(np.diff(record.posture[-50:, :ARM_JOINTS], axis=0)).max(initial=0.0)
        if not monitor.neighbour_untouched(cans):
            return "neighbour moved"
        if tilt(cans[:7]) > UPRIGHT_TOLERANCE and not self._held(record):
            return "can toppled"
        if moved < np.deg2rad(0.1):
            return "stalled"
        if not picked:
            return "missed grasp"
        if monitor.released(record.posture[-1]) and not monitor.placed(cans):
            return "misplaced"
        return "time"

    def _held(self, record: Record) -> bool:
        return record.posture[-1, -1] < 0.5 * self.world.opening and record.can_poses[-1, 6] - CAN_HALF_HEIGHT > LIFTED


class _Narrator:
    """Turns what happens into a few words a person can follow."""

    def __init__(self, monitor: TaskMonitor, standing: float, tell: Callable[[float, str], None] | None):
        self.events: list[tuple[float, str]] = []
        self._monitor, self._standing, self._tell = monitor, standing, tell
        self._was: dict[str, bool] = {}

    def say(self, seconds: float, what: str) -> None:
        self.events.append((seconds, what))
        if self._tell is not None:
            self._tell(seconds, what)

    def see(self, seconds: float, posture: np.ndarray, alpha: float, active: bool, cans: np.ndarray) -> None:
        monitor = self._monitor
        held = not monitor.released(posture) and cans[6] - self._standing > LIFTED
        returning = alpha >= FALSE_ALARM or (self._was.get("returning", False) and alpha > RESUMED)
        for name, now, begins, ends in (
            ("subtask 1", not held and not monitor.placed(cans), "subtask 1: pick the can", None),
            ("disturbed", active, "the experimenter disturbs the arm", "the experimenter lets the arm go"),
            ("returning", returning, "recall fails: switched to the LQR", "recalls again: the network resumes"),
            ("home", returning and monitor.home(posture), "at the initial posture", None),
            ("held", held, "picked; subtask 2: place the can", None),
            ("placed", monitor.placed(cans) and monitor.released(posture), "placed", None),
        ):
            if now != self._was.get(name, False):
                text = begins if now else ends
                if text is not None:
                    self.say(seconds, text)
            self._was[name] = now
