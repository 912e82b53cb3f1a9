"""Rollout: the whole system as one root Diagram, built once, that runs episode after episode on fresh contexts."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import ZeroOrderHold

from diagrams.episodes.calibration import RECALL, Calibration, stored_calibration
from diagrams.episodes.compatibility import require_trained_for
from diagrams.episodes.controller import make_controller
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.narrator import Narrator
from diagrams.episodes.outcome import make_outcome
from diagrams.episodes.prefix import BRANCH_LEVELS, Prefix
from diagrams.episodes.record import ARRAYS, Record
from diagrams.episodes.run_log import COMMAND, RunLog
from diagrams.episodes.switching import GUARD, Switching, Until
from diagrams.episodes.way_home import WayHome
from diagrams.world.can_mover import CanMover
from diagrams.world.clearance_map import tell_of_cans
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.registry import FAULTS
from diagrams.world.faults.wiring import FaultInDiagram
from diagrams.world.ghost import add_ghost
from diagrams.world.hands import Hands
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, other_spot
from diagrams.world.requirement_watch import RequirementWatch
from diagrams.world.station import PickPlaceStation
from diagrams.world.task import TIME_LIMIT, TaskMonitor
from diagrams.world.way_home_wiring import add_way_home
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.dialled_detector import DialledDetector
from systems.disturbance import Disturbance
from systems.recoveries.registry import RECOVERIES, SHIPPED

FILTERED = ("measured_posture", "alpha", COMMAND)  # outputs of the controller that go into `add_way_home`
WATCHED = ("measured_posture", "alpha", "active")  # after each step of the plant on a way home


class Rollout:
    """Station, controller and disturbance, wired as systems/README.md says.

    Everything that runs is in `diagram`, all its state in the Context: the loop of a Simulator of one's own, which
    systems/README.md shows, gives the same bits as `run`. What watches the run is `requirements`; `log`: what of it and
    of the controller is logged.
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
        fault: str | None = None,
        recovery: str = SHIPPED,
        monitored: bool = False,
    ):
        """
        Args:
            encoder, policy: see models/inference.py.
            detector, calibration: see systems/detector.py; None: the recall, with the policy's own calibration.
            meshcat: where the run is shown.
            video: an .mp4 to write, finished by `self.video.Save()`.
            hands: with a person's hands (`self.hands`, see world/hands.py) between the parts.
            fault: with the system of this fault (`self.fault`, see world/faults/) between the parts.
            recovery: what the arm does while alpha is high, of systems/recoveries/.
            monitored: whether `requirements` tells in each tick how well they are kept; 1 to 5 % of a run's time.

        Raises InputError for networks, camera and world that do not fit together.
        """
        require_trained_for(world, policy)
        self.world, self.policy = world, policy
        builder = DiagramBuilder()
        needs = () if fault is None else FAULTS[fault].needs
        pulled = hands or "applied_spatial_force" in needs
        self.station = builder.AddSystem(PickPlaceStation(world, True, video is not None, pulled, needs))
        if detector is None:
            detector = DETECTORS[RECALL].build(policy, ARM_JOINTS, {})
            calibration = calibration or stored_calibration(RECALL, policy, Path())
        self.calibration = calibration
        if hands:
            detector = DialledDetector(detector)
        self.controller = make_controller(world, self.station, encoder, policy, detector, recovery)
        builder.AddNamedSystem("switched_controller", self.controller)
        station, controller, plant, period = self.station, self.controller, self.station.plant, world.timing.period
        disturbance = self.disturbance = Disturbance(posture_size=policy.posture_size, period=period)
        builder.AddNamedSystem("disturbance", disturbance)
        self.can_mover = builder.AddNamedSystem("can_mover", CanMover())
        signals = {name: station.GetOutputPort(name) for name in ("rgb_image", "posture", "finger_gap")}
        signals |= {name: disturbance.GetOutputPort(name) for name in ("ticks_since_onset", "active")}
        signals |= {
            "desired_posture": disturbance.GetOutputPort("disturbed_posture"),
            "alpha": controller.GetOutputPort("alpha"), "can_place": self.can_mover.GetOutputPort("can_place"),
        }  # fmt: skip
        self.fault, self.hands = None, None
        if fault is not None:
            self.fault = FaultInDiagram(builder, station, fault, policy.posture_size, signals)
            signals = self.fault.signals
        if hands:
            self.hands = Hands(builder, world, station, signals)
            signals = self.hands.signals
            builder.Connect(self.hands.gamma, controller.GetInputPort("gamma"))
        known = signals["active"] if self.fault is None else self.fault.fault.GetOutputPort("acting")
        if controller.HasInputPort("active"):
            builder.Connect(known, controller.GetInputPort("active"))
        if "spatial_force" in signals:
            builder.Connect(signals["spatial_force"], station.GetInputPort("applied_spatial_force"))
        builder.Connect(signals["rgb_image"], controller.GetInputPort("rgb_image"))
        builder.Connect(signals["posture"], controller.GetInputPort("posture"))
        if world.releases:
            builder.Connect(station.GetOutputPort("finger_gap"), controller.GetInputPort("finger_gaps"))
        posture, alpha, command = (controller.GetOutputPort(name) for name in FILTERED)
        looks, regulated = RECOVERIES[recovery].looks, controller.HasSubsystemNamed("regulated_mixer")
        filtered = add_way_home(builder, world, station, posture, alpha, command, looks, regulated)
        command = filtered if self.hands is None else self.hands.late(builder, filtered)
        builder.Connect(command, disturbance.GetInputPort("desired_posture"))
        builder.Connect(station.GetOutputPort("approach_distance"), disturbance.GetInputPort("trigger"))
        builder.Connect(disturbance.GetOutputPort("ticks_since_onset"), self.can_mover.get_input_port())
        for name in ("desired_posture", "can_place"):
            builder.Connect(signals[name], station.GetInputPort(name))
        self.requirements = RequirementWatch(
            builder, world, station, alpha, signals["active"], posture, filtered, monitored
        )
        self.log = RunLog(builder, controller, filtered, self.requirements.signals, period)
        self._ports = {
            name: (system, system.GetOutputPort(name))
            for system, name in (
                (controller, "measured_posture"), (controller, "alpha"), (self.can_mover, "taken"),
                (station, "can_poses"), (plant, "state"), (station, "approach_distance"),
                (disturbance, "ticks_since_onset"),
            )
        } | {name: (signals[name].get_system(), signals[name]) for name in ("active", "rgb_image")}  # fmt: skip
        self._ports["acting"] = known.get_system(), known
        if controller.HasOutputPort("given_up"):
            self._ports["given_up"] = controller, controller.GetOutputPort("given_up")
        if self.fault is not None and self.fault.alters_posture:  # the truth, which is judged
            true = builder.AddNamedSystem("true_posture", ZeroOrderHold(period, policy.posture_size))
            builder.Connect(station.GetOutputPort("posture"), true.get_input_port())
            self._ports["true_posture"] = true, true.get_output_port()
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
        station, context = self.station, self.diagram.CreateDefaultContext()
        station.set_scene(context, np.asarray(episode.can_xy), episode.vacant)
        tell_of_cans(self.diagram, context, station)
        self._set_disturbance(context, episode)
        if self.hands is not None:
            self.hands.set(context, episode.hands, episode.seed)
        elif episode.hands:
            raise InputError("the episode has a person's hands, the diagram has none: build it with hands=True")
        if (used := calibration or self.calibration) is None:
            raise InputError("the detector has no calibration: give one, or run diagrams/baselines.py")
        try:
            self.controller.set_calibration(context, used.mean_errors, used.beta, used.gamma)
        except ValueError as error:
            raise InputError(f"the calibration does not fit the detector: {error}") from error
        return context

    def _set_disturbance(self, context: Context, episode: Episode) -> None:
        """In the root Context; its state is left alone."""
        meter, given, onset = self.station.approach_meter, episode.disturbance, episode.disturbance.onset
        meter.set_subtask(meter.GetMyMutableContextFromRoot(context), given.subtask)
        self.disturbance.set_parameters(self.disturbance.GetMyMutableContextFromRoot(context), onset)
        own = given if given.fault is None else DisturbanceSpec()  # what a fault moves, it moves itself
        self.can_mover.set_parameters(self.can_mover.GetMyMutableContextFromRoot(context), own)
        if self.fault is not None:
            stands = np.array([*episode.can_xy, CAN_HALF_HEIGHT])
            self.fault.set(context, given, episode.seed, stands, self.station.spot(other_spot(episode.vacant)))
        elif given.fault is not None:
            raise InputError(f"the episode has the fault '{given.label}', the diagram has none: build it with fault")

    def prepare(
        self, episode: Episode, calibration: Calibration | None = None, start: Prefix | None = None
    ) -> TaskMonitor:
        """Puts a Context for `episode` into the simulator: a fresh one, see `create_context`, or a clone of `start`."""
        station = self.station
        context = self.create_context(episode, calibration) if start is None else start.context.Clone()
        self._set_disturbance(context, episode)
        self.simulator.reset_context(context)
        self.simulator.Initialize()
        goal, neighbour = station.spot(episode.vacant), station.spot(other_spot(episode.vacant))
        if self.fault is not None:
            neighbour = self.fault.neighbour(context, neighbour)
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
        given = episode.disturbance
        narrator, switching = Narrator(monitor, on_event), Switching(given.takes_arm, period, given.several)
        root = self.simulator.get_context()
        ports = {name: (port, system.GetMyContextFromRoot(root)) for name, (system, port) in self._ports.items()}
        rows: dict[str, list] = {name: [] if start is None else list(start.rows[name]) for name in ARRAYS}
        true = list(rows["posture"]) if "true_posture" in ports else rows["posture"]
        way_home = WayHome(self.station)
        success = diverged = cut = begun = homing = False
        limit, k = round(time_limit / period) + episode.hands.last_tick, 0 if start is None else start.ticks
        put = {int(row[0]) for row in episode.hands.can}

        def evaluated(name: str) -> np.ndarray:
            port, context = ports[name]
            return port.Eval(context).copy()

        def judge(k: int, taken: bool) -> bool:
            """Tells of row k; whether the arm is at its initial posture."""
            alpha, active, cans = (rows[name][k] for name in ("alpha", "active", "can_poses"))
            posture = true[k]
            home = bool(monitor.home(posture))
            narrator.see(k * period, posture, alpha, active, taken, cans, home)
            switching.see(alpha, active, home)
            return home

        for earlier in range(k):
            judge(earlier, False)
        # A person may have gone on after the task was done.
        while k < limit + switching.ticks_disturbed and not (success and k > episode.hands.last_tick) and not cut:
            began = time.perf_counter()
            # Half a plant step before the tick the plant is as the tick sees it, and no event is pending.
            if keep is not None and k and not homing and self.advance(k * period - 0.5 * self.world.timing.time_step):
                port, context = ports["approach_distance"]
                if float(port.Eval(context)[0]) < BRANCH_LEVELS.get(episode.disturbance.subtask, -np.inf):
                    if not switching.crossings and not switching.ticks_disturbed:
                        keep(Prefix.taken(root, rows, episode.disturbance.subtask))
                    keep = None
            # To the middle of the tick: its outputs hold from the update to the next one.
            if not self._to_middle(k, homing, way_home, ports):
                if not k:
                    raise InputError("the simulation diverges in its first tick: choose a softer world.servo")
                diverged = True  # what came before is kept
                break
            posture, cans = evaluated("measured_posture"), evaluated("can_poses")
            alpha, active = float(evaluated("alpha")[0]), bool(evaluated("active")[0] > 0.5)
            homing = alpha >= GUARD and not active
            for name, value in (("posture", posture), ("alpha", alpha), ("active", active), ("can_poses", cans)):
                rows[name].append(value)
            if true is not rows["posture"]:
                true.append(evaluated("true_posture"))
            if not begun and evaluated("ticks_since_onset")[0] >= 0.0:
                begun = True
                if given.fault is not None and given.severity:
                    narrator.say(k * period, f"{given.label} begins")
            if picture_every and k % picture_every == 0:
                port, context = ports["rgb_image"]
                rows["picture_ticks"].append(k)
                rows["pictures"].append(port.Eval(context).data[:, :, :3].copy())
            home = judge(k, bool(evaluated("taken")[0] > 0.5) or k in put)
            if "given_up" in ports and evaluated("given_up")[0] > 0.5:
                narrator.give_up(k * period)
            success = home and not active and monitor.success(cans, np.array(true), self.station.finger_gap(root))
            cut = switching.over(until)
            rows["tick_seconds"].append(time.perf_counter() - began)
            k += 1
            if on_tick is not None:
                on_tick(k)
        unfinished = "the simulation diverged" if diverged else f"{until} decided" if cut else "time is up"
        narrator.say((k - 1) * period, "task done" if success else unfinished)
        arrays = {name: np.array(values) for name, values in rows.items()} | self.log.rows(root, k)
        record = Record(events=narrator.events, **arrays | {"time": np.arange(k) * period})
        seen = monitor, record, switching, way_home, success, diverged, begun
        outcome = make_outcome(episode, *seen, period, self.policy.hash, np.array(true), until)
        outcome.wall_seconds = time.perf_counter() - started
        outcome.realtime_factor = outcome.sim_seconds / outcome.wall_seconds
        return outcome, record

    def judged(self, name: str) -> np.ndarray:
        """The value of a port that is looked at in every tick, or of the plant's state, now."""
        system, port = self._ports[name]
        return port.Eval(system.GetMyContextFromRoot(self.simulator.get_context())).copy()

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
