"""Rollout: the whole system as one root Diagram, built once, that runs episode after episode on fresh contexts."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import LogVectorOutput, Multiplexer

from diagrams.episodes.calibration import RECALL, Calibration, stored_calibration
from diagrams.episodes.compatibility import require_trained_for
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.narrator import Narrator
from diagrams.episodes.outcome import make_outcome
from diagrams.episodes.prefix import BRANCH_LEVELS, Prefix
from diagrams.episodes.record import ARRAYS, Record
from diagrams.episodes.switching import GUARD, Switching, Until
from diagrams.episodes.way_home import WayHome
from diagrams.world.can_mover import CanMover
from diagrams.world.clearance_map import add_clearance_filter
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.ghost import add_ghost
from diagrams.world.hands import Hands
from diagrams.world.names import ARM_JOINTS, other_spot
from diagrams.world.station import PickPlaceStation, controller_limits
from diagrams.world.task import HOME_TOLERANCE, TIME_LIMIT, TaskMonitor
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.dialled_detector import DialledDetector
from systems.disturbance import Disturbance
from systems.switched_controller import SwitchedController

COMMAND = "desired_posture"  # as it comes out of the clearance filter
FILTERED = ("measured_posture", "alpha", COMMAND)  # outputs of the controller that go into it
# Outputs of the controller that are logged, under their own names.
LOGGED = ("rnn_step", "regulator_step", COMMAND, "errors", "hidden_state", "predicted_features")
WATCHED = ("measured_posture", "alpha", "active")  # after each step of the plant on a way home
JUDGED = ("measured_posture", "alpha", "active", "taken", "can_poses")  # looked at in every tick


class Rollout:
    """Station, controller and disturbance, wired as systems/README.md says.

    Everything that runs is in `diagram`, all its state in the Context: the loop of a Simulator of one's own, which
    systems/README.md shows, gives the same bits as `run`.
    """

    def __init__(
        self,
        world: World,
        encoder,
        policy,
        detector: System | None = None,
        calibration: Calibration | None = None,
        meshcat=None,
        video: Path | None = None,
        hands: bool = False,
    ):
        """
        Args:
            encoder, policy: see models/inference.py.
            detector, calibration: see systems/detector.py; None: the recall, with the policy's own calibration.
            meshcat: where the run is shown.
            video: an .mp4 to write, finished by `self.video.Save()`.
            hands: with a person's hands (`self.hands`, see world/hands.py) between the parts.

        Raises InputError for networks, camera and world that do not fit together.
        """
        require_trained_for(world, policy)
        self.world, self.policy = world, policy
        builder = DiagramBuilder()
        self.station = builder.AddSystem(PickPlaceStation(world, film_camera=video is not None, pulled=hands))
        lower, upper, speed = controller_limits(self.station)
        if detector is None:
            detector = DETECTORS[RECALL].build(policy, ARM_JOINTS, {})
            calibration = calibration or stored_calibration(RECALL, policy, Path())
        self.calibration = calibration
        if hands:
            detector = DialledDetector(detector)
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
                speed_limits=speed[:ARM_JOINTS],
                finger_openings=(world.closed_opening, world.opening),
                finger_thresholds=(world.close_below, world.open_above),
                period=world.timing.period,
                image_width=world.camera.width,
                image_height=world.camera.height,
                home_tolerance=HOME_TOLERANCE if world.resumption == "reset" else None,
                empty_below=world.empty_below if world.releases else None,
            )
        except ValueError as error:
            raise InputError(f"the controller cannot be built: {error}") from error
        builder.AddNamedSystem("switched_controller", self.controller)
        station, controller, period = self.station, self.controller, world.timing.period
        plant = station.plant
        disturbance = self.disturbance = Disturbance(posture_size=policy.posture_size, period=period)
        builder.AddNamedSystem("disturbance", disturbance)
        self.can_mover = builder.AddNamedSystem("can_mover", CanMover())
        image, disturbed, active, place = (
            system.GetOutputPort(name)
            for system, name in ((station, "rgb_image"), (disturbance, "disturbed_posture"), (disturbance, "active"),
                                 (self.can_mover, "can_place"))
        )  # fmt: skip
        self.hands = Hands(builder, world, station, disturbed, active, place) if hands else None
        if self.hands is not None:
            image, disturbed, active, place = (
                self.hands.image, self.hands.command, self.hands.active, self.hands.place,
            )  # fmt: skip
            builder.Connect(self.hands.gamma, controller.GetInputPort("gamma"))
        if controller.HasInputPort("active"):
            builder.Connect(active, controller.GetInputPort("active"))
        builder.Connect(image, controller.GetInputPort("rgb_image"))
        builder.Connect(station.GetOutputPort("posture"), controller.GetInputPort("posture"))
        if world.releases:
            builder.Connect(station.GetOutputPort("finger_gap"), controller.GetInputPort("finger_gaps"))
        self._command = add_clearance_filter(
            builder, world, station, *(controller.GetOutputPort(name) for name in FILTERED)
        )
        builder.Connect(self._command, disturbance.GetInputPort("desired_posture"))
        builder.Connect(station.GetOutputPort("approach_distance"), disturbance.GetInputPort("trigger"))
        builder.Connect(disturbed, station.GetInputPort("desired_posture"))
        builder.Connect(disturbance.GetOutputPort("ticks_since_onset"), self.can_mover.get_input_port())
        builder.Connect(place, station.GetInputPort("can_place"))
        # Logged at a tick, before its update: what the network is fed; all else is still of the tick before.
        logged = [self._command if name == COMMAND else controller.GetOutputPort(name) for name in LOGGED]
        self._sizes = [port.size() for port in logged]
        self._logged = builder.AddNamedSystem("logged", Multiplexer(self._sizes))
        for i, port in enumerate(logged):
            builder.Connect(port, self._logged.get_input_port(i))
        self._log = LogVectorOutput(self._logged.get_output_port(), builder, period)
        self._input_log = LogVectorOutput(controller.GetOutputPort("network_input"), builder, period)
        self._log.set_name("log")
        self._input_log.set_name("network_input_log")
        self._ports = {
            name: (system, system.GetOutputPort(name))
            for system, name in (
                (controller, "measured_posture"), (controller, "alpha"), (self.can_mover, "taken"),
                (station, "can_poses"), (plant, "state"), (station, "approach_distance"),
            )
        } | {name: (port.get_system(), port) for name, port in (("active", active), ("rgb_image", image))}  # fmt: skip
        self.video = None
        if video is not None:
            from pydrake.visualization import VideoWriter

            self.video = builder.AddSystem(VideoWriter(filename=str(video), fps=1 / period, backend="cv2"))
            builder.Connect(station.GetOutputPort("film_image"), self.video.get_input_port())
        if meshcat is not None:
            from pydrake.geometry import MeshcatVisualizer

            # The scene graph is inside the station, where ApplyVisualizationConfig does not look.
            MeshcatVisualizer.AddToBuilder(builder, station.GetOutputPort("query_object"), meshcat)
            add_ghost(builder, meshcat, world, controller, policy.scaling)
        self.diagram = builder.Build()
        self.diagram.set_name("pick_place")
        self.simulator = Simulator(self.diagram)

    def create_context(self, episode: Episode, calibration: Calibration | None = None) -> Context:
        """A fresh Context of `diagram` for `episode`, at time 0; `calibration` instead of the constructor's."""
        station, given, context = self.station, episode.disturbance, self.diagram.CreateDefaultContext()
        station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        self._set_disturbance(context, given)
        if self.hands is not None:
            self.hands.set(context, episode.hands)
        elif episode.hands:
            raise InputError("the episode has a person's hands, the diagram has none: build it with hands=True")
        if (used := calibration or self.calibration) is None:
            raise InputError("the detector has no calibration: give one, or run diagrams/baselines.py")
        self.controller.set_calibration(context, used.mean_errors, used.beta, used.gamma)
        return context

    def _set_disturbance(self, context: Context, given: DisturbanceSpec) -> None:
        """In the root Context; its state is left alone."""
        meter = self.station.approach_meter
        meter.set_subtask(meter.GetMyMutableContextFromRoot(context), given.subtask)
        self.disturbance.set_parameters(self.disturbance.GetMyMutableContextFromRoot(context), given)
        self.can_mover.set_parameters(self.can_mover.GetMyMutableContextFromRoot(context), given)

    def prepare(
        self, episode: Episode, calibration: Calibration | None = None, start: Prefix | None = None
    ) -> TaskMonitor:
        """Puts a Context for `episode` into the simulator: a fresh one, see `create_context`, or a clone of `start`."""
        station = self.station
        context = self.create_context(episode, calibration) if start is None else start.context.Clone()
        self._set_disturbance(context, episode.disturbance)
        self.simulator.reset_context(context)
        self.simulator.Initialize()
        goal, neighbour = station.spot(episode.vacant), station.spot(other_spot(episode.vacant))
        return TaskMonitor(goal, neighbour, self.world.initial_posture, self.world.timing.period)

    def run(
        self,
        episode: Episode,
        on_event: Callable[[float, str], None] | None = None,
        on_tick: Callable[[int], None] | None = None,
        until: Until = "task",
        picture_every: int = 0,
        time_limit: float = TIME_LIMIT,
        calibration: Calibration | None = None,
        start: Prefix | None = None,
        keep: Callable[[Prefix], object] | None = None,
    ) -> tuple[Outcome, Record]:
        """Runs `episode` to success, to its time limit, or to what `until` says; its ticks are those of the whole run.

        A success that comes before the last that a person's hands did ends nothing.

        Args:
            on_event: is told (s, what happened); on_tick: is told the number of ticks so far.
            picture_every: ticks between two pictures of the camera that are kept; 0: none are.
            time_limit: s, plus the time disturbed, after the last that a person's hands did.
            calibration: see `prepare`.
            start: what the run begins with instead of tick 0: of the same scene, network and calibration.
            keep: is given such a beginning, once, where the distance to the goal falls below BRANCH_LEVELS.
        """
        started, period = time.perf_counter(), self.world.timing.period
        monitor = self.prepare(episode, calibration, start)
        narrator, switching = Narrator(monitor, on_event), Switching(episode.disturbance.takes_arm, period)
        root = self.simulator.get_context()
        ports = {name: (port, system.GetMyContextFromRoot(root)) for name, (system, port) in self._ports.items()}
        judged = [ports[name] for name in JUDGED]
        rows: dict[str, list] = {name: [] if start is None else list(start.rows[name]) for name in ARRAYS}
        way_home = WayHome(self.station)
        success = diverged = cut = can_moved = homing = False
        limit, k = round(time_limit / period) + episode.hands.last_tick, 0 if start is None else start.ticks
        put = {int(row[0]) for row in episode.hands.can}

        def judge(k: int, taken: bool) -> bool:
            """Tells of row k; whether the arm is at its initial posture."""
            posture, alpha, active, cans = (rows[name][k] for name in ("posture", "alpha", "active", "can_poses"))
            home = bool(monitor.home(posture))
            narrator.see(k * period, posture, alpha, active, taken, cans, home)
            switching.see(alpha, active, home)
            return home

        for earlier in range(k):
            judge(earlier, False)
        # A person may have gone on after the task was done.
        while k < limit + switching.ticks_disturbed and not (success and k > episode.hands.last_tick) and not cut:
            # Half a plant step before the tick the plant is as the tick sees it, and no event is pending.
            if keep is not None and k and not homing and self.advance(k * period - 0.5 * self.world.timing.time_step):
                port, context = ports["approach_distance"]
                if float(port.Eval(context)[0]) < BRANCH_LEVELS.get(episode.disturbance.subtask, -np.inf):
                    if not switching.crossings and not switching.ticks_disturbed:
                        keep(Prefix.taken(root, rows, episode.disturbance.subtask))
                    keep = None
            # To the middle of the tick: its outputs hold from the update to the next one.
            if not self._to_middle(k, homing, way_home, ports):
                diverged = True  # what came before is kept
                break
            posture, alpha, active, taken, cans = [port.Eval(context).copy() for port, context in judged]
            alpha, active = float(alpha[0]), bool(active[0] > 0.5)
            homing = alpha >= GUARD and not active
            for name, value in (("posture", posture), ("alpha", alpha), ("active", active), ("can_poses", cans)):
                rows[name].append(value)
            if picture_every and k % picture_every == 0:
                port, context = ports["rgb_image"]
                rows["picture_ticks"].append(k)
                rows["pictures"].append(port.Eval(context).data[:, :, :3].copy())
            home = judge(k, taken[0] > 0.5 or k in put)
            can_moved |= bool(taken[0] > 0.5)
            success = (
                home and not active and monitor.success(cans, np.array(rows["posture"]), self.station.finger_gap(root))
            )
            cut = switching.over(until)
            k += 1
            if on_tick is not None:
                on_tick(k)
        unfinished = "the simulation diverged" if diverged else f"{until} decided" if cut else "time is up"
        narrator.say((k - 1) * period, "task done" if success else unfinished)
        arrays = {name: np.array(values) for name, values in rows.items()} | self._logs(k)
        record = Record(events=narrator.events, **arrays | {"time": np.arange(k) * period})
        seen = monitor, record, switching, way_home, success, diverged, can_moved
        outcome = make_outcome(episode, *seen, period, self.policy.hash)
        if until != "task":  # what was cut short is not judged
            outcome.success = None
            outcome.failure = outcome.failure if diverged else None
            outcome.switch_success = outcome.switch_success if until == "switching" else None
            outcome.paper_switch_success = outcome.paper_switch_success if until == "as_paper" else None
        outcome.wall_seconds = time.perf_counter() - started
        outcome.realtime_factor = outcome.sim_seconds / outcome.wall_seconds
        return outcome, record

    def judged(self, name: str) -> np.ndarray:
        """The value of a port of JUDGED, or of the plant's state, now."""
        system, port = self._ports[name]
        return port.Eval(system.GetMyContextFromRoot(self.simulator.get_context())).copy()

    def latest(self) -> dict[str, np.ndarray]:
        """What a Record has of the present tick and is logged, by name; the logs are emptied.

        For runs without an end; `run` has no use of it.
        """
        root = self.simulator.get_mutable_context()
        parts = self._logged.get_output_port().Eval(self._logged.GetMyContextFromRoot(root))
        found = dict(zip(LOGGED, np.split(parts, np.cumsum(self._sizes)[:-1]), strict=True))
        found["network_input"] = self._input_log.FindLog(root).data()[:, -1].copy()
        for log in (self._log, self._input_log):
            log.FindMutableLog(root).Clear()
        return found

    def _logs(self, ticks: int) -> dict[str, np.ndarray]:
        """What was logged of the first `ticks` ticks, (ticks, size) by name."""
        root = self.simulator.get_context()
        last = self._logged.get_output_port().Eval(self._logged.GetMyContextFromRoot(root))
        rows = np.vstack((self._log.FindLog(root).data().T[1:], last))[:ticks]
        parts = np.split(rows, np.cumsum(self._sizes)[:-1], axis=1)
        network_input = self._input_log.FindLog(root).data().T[:ticks]
        return dict(zip((*LOGGED, "network_input"), map(np.ascontiguousarray, (*parts, network_input)), strict=True))

    def _to_middle(self, k: int, homing: bool, way_home: WayHome, ports: dict) -> bool:
        """To the middle of tick k, see `advance`; on a way home it is looked at after each step of the plant.

        `homing`: whether the arm was on a way home in the tick before.
        """
        period, steps = self.world.timing.period, round(self.world.timing.period / self.world.timing.time_step)
        root = self.simulator.get_context()
        first = steps // 2 + 1  # that the plant takes after the update of tick k
        for step in range(1 if homing else first, steps + 1):
            if not self.advance((k - 0.5 + step / steps) * period):
                return False
            posture, alpha, active = (p.Eval(c) for p, c in map(ports.__getitem__, WATCHED))
            if alpha[0] < GUARD or active[0] > 0.5:
                break
            way_home.see(root, closed=bool(posture[ARM_JOINTS] < self.world.close_below))
        return self.advance((k + 0.5) * period)

    def advance(self, seconds: float) -> bool:
        """To that time; False if the physics diverged: something hard was squeezed between hard things."""
        try:
            self.simulator.AdvanceTo(seconds)
        except RuntimeError as error:
            if "non-finite" not in str(error):
                raise
            return False
        # The last step may have overflowed, and Drake ends the process that asks for a pose then.
        return bool(np.isfinite(self.judged("state")).all())
