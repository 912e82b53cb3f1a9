"""Starts of a resumption in the whole system: the arm comes home, the network is anywhere.

The scene, the image and the can (on the desk or in the hand) are those of a switching point of an undisturbed episode;
or the can was taken from the hand meanwhile, which comes home closed, and stands somewhere on the desk. What varies is
the rest of the hybrid state: the network's memory is that of a random tick of the same subtask, after it has imagined
what follows for as long as a disturbance and a way home last; the arm is anywhere within the tolerance of the initial
posture, and moves on as the LQR does, having come straight.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from diagrams.episodes.calibration import Calibration
from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.switching import GUARD, RESUMED
from diagrams.hybrid.box_gauge import BoxGauge
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CANS
from diagrams.world.station import can_body
from diagrams.world.task import HOME_TOLERANCE, TIME_LIMIT, TaskMonitor, lifted

IMAGINED_TICKS = (30, 60)  # since the memory's tick: of a disturbance and a way home, inclusive
SUBTASKS = (1, 2)
# Kinds of starts: the subtask in which the network was, and the one that is to be done.
KINDS = {"pick": (1, 1), "place": (2, 2), "can taken": (2, 1)}


@dataclass(frozen=True)
class Memory:
    """What the network's state holds after a tick, scaled."""

    hidden: np.ndarray  # (S,)
    predicted: np.ndarray  # (M + F,) of the next tick, clipped
    recalled: np.ndarray  # (N, M)

    def imagined(self, policy) -> Self:
        """One tick later, the network fed with what it predicted: alpha = 1 in Eqs. 7 and 8."""
        y, hidden, recalled = policy.step(self.predicted, self.hidden)
        return type(self)(hidden, np.clip(y, -1.0, 1.0), recalled)


@dataclass(frozen=True)
class SwitchingPoint:
    """The arm at its initial posture before a subtask, and what the network went through in that subtask."""

    subtask: int
    context: Context  # the root's, half a plant step before a tick
    tick: int  # that one
    memories: list[Memory]  # after each tick of the subtask


@dataclass(frozen=True)
class Start:
    """The random part of a start."""

    kind: str  # of KINDS
    memory: Memory
    left: int  # ticks of the subtask that the network has still to imagine; negative: beyond its end
    offset: np.ndarray  # (7,) of the arm to the initial posture, rad
    can_xy: np.ndarray  # (2,) m, world: where the can stands if it was taken

    @classmethod
    def drawn(cls, kind: str, point: SwitchingPoint, world: World, policy, rng: np.random.Generator) -> Self:
        """A tick of the subtask, a posture within the tolerance and a place in the trained area, all uniform."""
        tick = int(rng.integers(len(point.memories)))
        imagined = int(rng.integers(IMAGINED_TICKS[0], IMAGINED_TICKS[1] + 1))
        memory = point.memories[tick]
        for _ in range(imagined):
            memory = memory.imagined(policy)
        left = len(point.memories) - 1 - tick - imagined
        offset = rng.uniform(-HOME_TOLERANCE, HOME_TOLERANCE, ARM_JOINTS)
        return cls(kind, memory, left, offset, rng.uniform(*world.grid.bounds))


def way_home(policy, offset: np.ndarray, gain: float) -> np.ndarray:
    """(N + 2, 7) scaled joints of the LQR's ideal way to `offset` (7, rad) from home: now and at the ticks before.

    `policy`: see models/inference.py; `gain`: of the LQR, a tick.
    """
    rows = np.tile(policy.initial_posture, (policy.horizon + 2, 1))
    rows[:, :ARM_JOINTS] += offset / (1.0 - gain) ** np.arange(len(rows))[:, None]
    return policy.scaling.scale(rows)[:, :ARM_JOINTS]


class Resumptions:
    """The closed loop of a Rollout, begun at switching points."""

    def __init__(self, rollout: Rollout, calibration: Calibration | None):
        """`rollout`: of a world whose network starts anew at home; `calibration`: of its detector."""
        self._calibration = calibration
        self.rollout, self.world, self.gain = rollout, rollout.world, BoxGauge.of(rollout.world).gain
        controller = rollout.controller
        self._network = controller.GetSubsystemByName("recurrent_policy")
        self._history = controller.GetSubsystemByName("posture_history")
        self._alpha_hold = controller.GetSubsystemByName("alpha_hold")
        self._home_reset = controller.GetSubsystemByName("home_reset")
        self._ports = {
            name: (system, system.GetOutputPort(name))
            for system, name in (
                (controller, "alpha"), (controller, "measured_posture"), (rollout.station, "can_poses"),
                (self._network, "hidden_state"), (self._network, "predicted_posture"),
                (self._network, "predicted_features"), (self._network, "recalled_postures"),
            )
        }  # fmt: skip

    @property
    def simulator(self):
        """The rollout's."""
        return self.rollout.simulator

    def switching_points(self, episode: Episode) -> tuple[list[SwitchingPoint], TaskMonitor]:
        """Those of an undisturbed `episode`; of a subtask that failed, or had a false alarm, there is none."""
        monitor, period = self.rollout.prepare(episode, self._calibration), self.world.timing.period
        begun: dict[int, tuple[Context, int]] = {}
        memories: dict[int, list[Memory]] = {subtask: [] for subtask in SUBTASKS}
        done, postures, subtask = set[int](), list[np.ndarray](), 1
        for k in range(1, round(TIME_LIMIT / period)):
            self._advance(k)
            if self._value("alpha")[0] >= GUARD:
                break
            if subtask not in begun:
                begun[subtask] = self.simulator.get_context().Clone(), k
            postures.append(self._value("measured_posture"))
            memories[subtask].append(self._memory())
            if self._done(subtask, monitor, postures):
                done.add(subtask)
                subtask += 1
                if subtask not in SUBTASKS:
                    break
        return [SwitchingPoint(s, *begun[s], memories[s]) for s in SUBTASKS if s in done], monitor

    def resume(
        self, point: SwitchingPoint, start: Start, monitor: TaskMonitor, *, reset: bool, limit: int, finish: int = 0
    ) -> tuple[int | None, bool | None]:
        """From `start`: ticks until the network has the arm, None beyond `limit`; and whether the subtask is done then.

        `reset`: whether the network starts anew at home. `finish`: ticks that the subtask has; 0: it is not run to its
        end, None, as without a resumption.
        """
        self._begin(point, start, reset)
        subtask = KINDS[start.kind][1]
        resumed, postures = None, list[np.ndarray]()
        for k in range(limit + 1):
            self._advance(point.tick + k + 1)
            if self._value("alpha")[0] <= RESUMED:
                resumed = k
                break
        if resumed is None or not finish:
            return resumed, None
        for k in range(resumed, resumed + finish):
            postures.append(self._value("measured_posture"))
            if self._done(subtask, monitor, postures):
                return resumed, True
            self._advance(point.tick + k + 2)
        return resumed, False

    def way_home(self, offset: np.ndarray) -> np.ndarray:
        """See the function of that name."""
        return way_home(self.rollout.policy, offset, self.gain)

    def _advance(self, tick: int) -> None:
        """To half a plant step before that tick: all outputs are those of the tick before."""
        timing = self.world.timing
        self.simulator.AdvanceTo(tick * timing.period - 0.5 * timing.time_step)

    def _value(self, name: str) -> np.ndarray:
        system, port = self._ports[name]
        return port.Eval(system.GetMyContextFromRoot(self.simulator.get_context())).copy()

    def _memory(self) -> Memory:
        predicted = np.concatenate((self._value("predicted_posture"), self._value("predicted_features")))
        recalled = self._value("recalled_postures").reshape(-1, self.rollout.policy.posture_size)[1:]
        return Memory(self._value("hidden_state"), predicted, recalled)

    def _done(self, subtask: int, monitor: TaskMonitor, postures: list[np.ndarray]) -> bool:
        cans, posture = self._value("can_poses"), postures[-1]
        if subtask == 1:
            return bool(lifted(cans) and monitor.held(cans, posture) and monitor.home(posture))
        gap = self.rollout.station.finger_gap(self.simulator.get_context())
        return monitor.success(cans, np.array(postures), gap)

    def _begin(self, point: SwitchingPoint, start: Start, reset: bool) -> None:
        """Makes the simulator's Context the switching point's, with the start's memory and posture.

        All of it but the abstract parameters, which are Drake's own (a rollout with a person's hands has others) and
        alike in every scene: to clone the geometry among them takes as long as 4 ticks. The logs are emptied.
        """
        root, kept = self.simulator.get_mutable_context(), point.context
        root.SetTime(kept.get_time())
        state = root.get_mutable_state()
        state.get_mutable_continuous_state().SetFrom(kept.get_state().get_continuous_state())
        state.get_mutable_discrete_state().SetFrom(kept.get_state().get_discrete_state())
        state.get_mutable_abstract_state().SetFrom(kept.get_state().get_abstract_state())
        for i in range(kept.num_numeric_parameter_groups()):
            root.get_mutable_numeric_parameter(i).SetFromVector(kept.get_numeric_parameter(i).value())
        for sink in self.rollout.log.sinks:
            sink.FindMutableLog(root).Clear()
        plant, station = self.rollout.station.plant, self.rollout.station
        local, grasp = plant.GetMyMutableContextFromRoot(root), plant.GetFrameByName("grasp")
        can = can_body(plant, CANS[0])
        X_GC: RigidTransform = can.body_frame().CalcPose(local, grasp)
        initial = self.world.initial_posture[:ARM_JOINTS]
        plant.SetPositions(local, station.arm, initial + start.offset)
        plant.SetVelocities(local, np.zeros(plant.num_velocities()))
        plant.SetVelocities(local, station.arm, -self.gain * start.offset / self.world.timing.period)
        if start.kind == "place":  # it is in the hand
            plant.SetFloatingBaseBodyPoseInWorldFrame(local, can, grasp.CalcPoseInWorld(local).multiply(X_GC))
        elif start.kind == "can taken":
            stands = RigidTransform(np.append(start.can_xy, CAN_HALF_HEIGHT))
            plant.SetFloatingBaseBodyPoseInWorldFrame(local, can, stands)
        history = self._history.GetMyMutableContextFromRoot(root)
        rows = history.get_discrete_state(0).value().reshape(-1, self.rollout.policy.posture_size).copy()
        rows[:, :ARM_JOINTS] = self.way_home(start.offset)[1:]
        history.SetDiscreteState(0, rows.ravel())
        # The mode is `return`: till the tick the network has no say in the command.
        self._alpha_hold.GetMyMutableContextFromRoot(root).SetDiscreteState(0, [1.0])
        self._network.set_memory(
            self._network.GetMyMutableContextFromRoot(root), start.memory.hidden, start.memory.predicted,
            start.memory.recalled,
        )  # fmt: skip
        if not reset:
            self._home_reset.set_tolerance(self._home_reset.GetMyMutableContextFromRoot(root), -np.ones(ARM_JOINTS))
        self.simulator.Initialize()
