"""A scene that runs on and on while people play with it; knows nothing of pages."""

import time
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from diagrams.episodes.calibration import controller_of, require_named, stored_calibration
from diagrams.episodes.narrator import Narrator
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.runner import build_rollout
from diagrams.episodes.sampling import EpisodeSampler
from diagrams.episodes.switching import GUARD
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands import Hands
from diagrams.world.names import ARM_JOINTS, DECODER, ENCODER
from diagrams.world.scenario import Scenario, save_scenario
from diagrams.world.task import REST_SECONDS
from models.errors import InputError
from models.inference import Decoder
from systems.camera_fault import FAULTS

KEPT_ROWS, KEPT_EVENTS = 400, 8
TASK, RETURN = "the network moves the arm", "the LQR brings the arm home"
DONE = "task done"
DIVERGED = "the simulation diverged: begin another scene"


class Session:
    """Scenes, one after the other, a tick at a time.

    Attributes:
        scenario: of the scene, without what the hands did: see `recorded`.
        scene, ticks: how many scenes were begun, and the ticks of this one.
        rows: of its last ticks, the newest last: see `_row`.
        events: the last (s, what happened), the newest last.
        mode, since: TASK or RETURN, and since when, s.
        ended: why no further tick can be run, or should be; empty: go on.
        diverged: whether the simulation did: no further tick can be run, and nothing can be seen.
    """

    def __init__(self, scenario: Scenario, weights: Path, meshcat=None):
        """`weights`: folder of the networks. Raises InputError as `begin` does, WeightsError for a damaged file."""
        self._weights, self._meshcat = weights, meshcat
        self._world, self._sampler = scenario.world, EpisodeSampler(scenario.world)
        self._rollouts: dict[tuple[str, str, str | None, str, str | None], Rollout] = {}
        self._chance = np.random.default_rng()  # of postures to move to: they are recorded, the dice are not
        self._holders: set[str] = set()
        self.scene = 0
        self.rows: deque[dict] = deque(maxlen=KEPT_ROWS)
        self.events: deque[tuple[float, str]] = deque(maxlen=KEPT_EVENTS)
        self.begin(scenario)
        self._decoder = Decoder(weights / DECODER) if (weights / DECODER).exists() else None

    def begin(self, scenario: Scenario) -> None:
        """Begins the scene of `scenario`; raises InputError, and leaves the present one, where it makes none."""
        scenario.check()
        episode = self._sampler.episode(scenario)
        rollout = self._rollout(scenario)
        calibration = stored_calibration(scenario.detector, rollout.policy, self._weights)
        self._monitor = rollout.prepare(episode, calibration)
        self.scenario, self.rollout, self.episode = scenario, rollout, episode
        self.gamma = episode.hands.gamma[-1][1] if episode.hands.gamma else calibration.gamma
        self.ticks, self.scene, self.ended, self.diverged = 0, self.scene + 1, "", False
        self._puller, self._put = "", -1  # who pulls, and in which tick the can was put last
        self.mode, self.since, self._done = TASK, 0.0, False
        self.rows.clear()
        self.events.clear()
        self._postures: deque[np.ndarray] = deque(maxlen=round(REST_SECONDS / self.period) + 2)
        self._narrator = Narrator(self._monitor, lambda *event: self.events.append(event))
        self._shown: tuple[int, np.ndarray, np.ndarray] | None = None
        self._features = np.zeros(rollout.policy.feature_size)
        # Who holds a button down goes on to hold the arm.
        self._holders, holders = set(), self._holders
        for holder in holders:
            self.hold(holder, True)

    def next_scene(self) -> None:
        """Begins the scene of the next seed, its can and spot sampled."""
        given = self.scenario.disturbance
        self.begin(
            replace(
                self.scenario, seed=self.scenario.seed + 1, can=None, vacant=None,
                disturbance=DisturbanceSpec(given.kind, severity=given.severity),
                hands=type(self.scenario.hands)(),
            )
        )  # fmt: skip

    def choose(self, **changes) -> None:
        """Begins a scene with another `seed`, `rnn` or `detector`."""
        self.begin(replace(self.scenario, **changes, hands=type(self.scenario.hands)()))

    def _rollout(self, scenario: Scenario) -> Rollout:
        controlled = scenario.rnn, scenario.detector, scenario.policy, scenario.recovery
        fault = scenario.disturbance.kind if scenario.disturbance.fault else None
        chosen = *controlled, fault
        if chosen not in self._rollouts:
            controller = replace(controller_of(self._weights, *controlled[:3]), recovery=scenario.recovery)
            shown = dict(meshcat=self._meshcat, hands=True, fault=fault)
            built = build_rollout(self._world, self._weights / ENCODER, controller, **shown)
            if scenario.policy is None:
                require_named(built.policy, scenario.rnn, controller.policy)
            self._rollouts[chosen] = built
        return self._rollouts[chosen]

    @property
    def period(self) -> float:
        """Of the ticks, s."""
        return self.rollout.world.timing.period

    @property
    def seconds(self) -> float:
        """Simulated in this scene."""
        return self.ticks * self.period

    # What the hands do, from the next tick on.

    @property
    def _hands(self) -> Hands:
        assert self.rollout.hands is not None
        return self.rollout.hands

    @property
    def _root(self):
        return self.rollout.simulator.get_mutable_context()

    def hold(self, holder: str, held: bool) -> None:
        """`holder`, such as a browser's page, holds the arm, or lets it go; it is free once nobody holds it."""
        before = bool(self._holders)
        (self._holders.add if held else self._holders.discard)(holder)
        if bool(self._holders) != before:
            self._hands.hold(self._root, self.ticks, held)

    def require_going(self) -> None:
        """Raises InputError after the simulation diverged: Drake ends the process that asks for a pose then."""
        if self.diverged:
            raise InputError(DIVERGED)

    def move(self) -> None:
        """Moves the arm to a random posture, as disturbance A; it is then held on where somebody holds it.

        Raises InputError where no posture is free.
        """
        self.require_going()
        target = self._sampler.pushed_away(self._chance, self._read("measured_posture"), self._read("can_poses"))
        self._hands.move(self._root, self.ticks, target, bool(self._holders))

    def pull(self, force: np.ndarray, puller: str = "") -> None:
        """`puller`, such as a page, pulls the hand by `force` (3,), N, world; raises InputError for too large a one."""
        self._hands.pull(self._root, self.ticks, force)
        self._puller = puller

    def leave(self, name: str) -> None:
        """`name` has no hands any more: what it holds and pulls is let go."""
        self.hold(name, False)
        if self._puller == name and self.force.any():
            self.pull(np.zeros(3))

    @property
    def force(self) -> np.ndarray:
        """(3,) N, world: of the pull."""
        return self._hands.newest(self._root, "force")

    @property
    def camera(self) -> str:
        """The camera's fault, of systems.camera_fault.FAULTS."""
        return FAULTS[int(self._hands.newest(self._root, "camera")[0])]

    def put_can(self, x: float, y: float) -> None:
        """Puts the can, wherever it is, on the desk at (x, y), m, world; raises InputError for a place out of reach."""
        self._sampler.require_reachable((x, y))
        self._hands.put_can(self._root, self.ticks, np.array([x, y]))
        self._put = self.ticks

    def fault(self, kind: str) -> None:
        """A fault of the camera, of systems.camera_fault.FAULTS."""
        self._hands.fault(self._root, self.ticks, kind)

    def set_gamma(self, gamma: float) -> None:
        """The detector's gamma; raises InputError outside of what can be chosen."""
        self._hands.set_gamma(self._root, self.ticks, gamma)
        self.gamma = gamma

    def recorded(self) -> Scenario:
        """The scene with all that the hands did in it."""
        return replace(self.scenario, hands=self._hands.schedule(self._root))

    def save(self, path: Path) -> None:
        """Writes `recorded` to `path`; pick_place.py --scenario replays it to the same bits.

        Raises InputError where it cannot be written.
        """
        try:
            save_scenario(path, self.recorded(), [f"As played for {self.seconds:.1f} s: pick_place.py --scenario FILE"])
        except OSError as error:
            raise InputError(f"{path} cannot be written ({error.strerror}): make room for it") from error

    # What is seen.

    def tick(self) -> None:
        """Runs one tick; afterwards `ended` may tell why there should be no other one.

        Raises InputError after the simulation diverged.
        """
        self.require_going()
        k, period = self.ticks, self.period
        if not self.rollout.advance((k + 0.5) * period):
            self.ended, self.diverged = DIVERGED, True
            return
        row = self._row(k)
        self.ticks += 1
        self.rows.append(row)
        mode = RETURN if row["alpha"] >= GUARD else TASK
        if mode != self.mode:
            self.mode, self.since = mode, row["time"]
        posture, cans = self._read("measured_posture"), self._read("can_poses")
        self._postures.append(posture)
        taken = bool(self._read("taken")[0] > 0.5) or self._put == k
        active, home = bool(row["active"]), bool(self._monitor.home(posture))
        self._narrator.see(row["time"], posture, row["alpha"], active, taken, cans, home)
        self._narrator.events.clear()
        gap = self.rollout.station.finger_gap(self._root)
        done = home and not active and self._monitor.success(cans, np.array(self._postures), gap)
        if done and not self._done:
            self._narrator.say(row["time"], DONE)
            self.ended = "task done: begin the next scene, or go on"
        self._done = done

    def _read(self, name: str) -> np.ndarray:
        return self.rollout.judged(name)

    def _row(self, k: int) -> dict:
        """Tick k in numbers: times s, angles deg, errors over gamma; of the wall clock, s since 1970, when it was."""
        found, controller = self.rollout.log.latest(self._root), self.rollout.controller
        scaling, size = self.rollout.policy.scaling, self.rollout.policy.posture_size
        own = controller.GetMyContextFromRoot(self._root)
        recalled = controller.GetOutputPort("recalled_postures").Eval(own).reshape(-1, size)
        self._features = found["network_input"][size:]
        errors = np.maximum(found["errors"] / self.gamma, 1e-6)
        horizon = len(recalled) - 1
        row = {
            "time": k * self.period, "imagined_time": (k + 1) * self.period,
            "recalled_time": (k - horizon) * self.period,
            "alpha": float(self._read("alpha")[0]), "worst": float(errors.max()), "first": float(errors[0]),
            "active": float(self._read("active")[0] > 0.5), "wall": time.time(),
        }  # fmt: skip
        for letter, posture in (
            ("m", self._read("measured_posture")),
            ("i", scaling.unscale(recalled[0])),
            ("r", scaling.unscale(recalled[-1])),
        ):
            for j, angle in enumerate(np.rad2deg(posture[:ARM_JOINTS]), 1):
                row[f"{letter}{j}"] = float(angle)
        return row

    def pictures(self) -> tuple[np.ndarray, np.ndarray]:
        """uint8 (112, 112, 3): what the camera gives now, and what the decoder makes of what the network was fed.

        That is the features of the camera's picture, and as far as alpha is above 0, of what it imagined to see; black
        where the weights have no decoder, which `second_title` says. Raises InputError after the simulation diverged.
        """
        self.require_going()
        if self._shown is None or self._shown[0] != self.ticks:
            port = self._hands.signals["rgb_image"]
            seen = port.Eval(port.get_system().GetMyContextFromRoot(self._root)).data[:, :, :3]
            said = np.zeros_like(seen) if self._decoder is None else self._decoder.decode(self._features)
            self._shown = self.ticks, seen.copy(), said
        return self._shown[1:]

    @property
    def second_title(self) -> str:
        """What the second of `pictures` shows."""
        if self._decoder is None:
            return f"{DECODER} is not among the weights"
        return "what the features say of it" if self.mode == TASK else "what it imagines to see"

    def can_xy(self) -> tuple[float, float]:
        """Where the can to pick is, m, world; raises InputError after the simulation diverged."""
        self.require_going()
        cans = self._read("can_poses")
        return float(cans[4]), float(cans[5])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of where the can may be put, m, world."""
        return self._world.grid.bounds
