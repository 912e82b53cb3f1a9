"""The way home that looks: the smallest change of a step that keeps the arm at a distance from what it knows."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import GUARD

WITHIN = 0.15  # m: what is farther has no say in a step; a step that leads beyond is looked at piece by piece
RESOLUTION = 0.01  # the proof of a step ends where it comes that near to the least distance, in parts of it
PRESENT, OF_LESS = 0.9, 0.5
MOST_PIECES = 50  # of one step's proof
PROGRESS = 0.1  # dm' . dm of dm . dm, at least, by which margins are kept
SLOW = 0.3  # the same, at least: else a change is counted otherwise, if by that the arm moves no less than
NOT_SHORTER = 0.5  # of as far


@dataclass(frozen=True)
class Near:
    """The pairs of a body of the arm, or of what it holds, and something else that are near each other."""

    distances: np.ndarray  # (n,) m; negative: so deep in each other
    jacobians: np.ndarray  # (n, J) their derivatives by the joint angles, m/rad
    pairs: np.ndarray  # (n,) numbers that tell one pair from another
    margins: np.ndarray  # (n,) m, >= 0: kept beyond the gap, as one of the two may be elsewhere than it is taken to be


class View(Protocol):
    """What there is to keep away from, as it is known at one posture."""

    def near(self, joints: np.ndarray, within: float) -> Near:
        """The pairs nearer than `within` (m) with the arm at `joints` (J, rad)."""

    def nearest(self, joints: np.ndarray, within: float, but: np.ndarray) -> float:
        """The smallest distance there, m, at most `within`, of all pairs but those numbered in `but`."""


class Map(Protocol):
    """What the arm knows of its surroundings."""

    reach: np.ndarray  # (J,) m/rad, > 0: no point of arm, or of what it holds, moves farther than sum_j reach_j |dq_j|
    obstacle_size: int  # of what it must be told at every tick; 0: it knows all it needs

    def view(self, posture: np.ndarray, obstacles: np.ndarray, returning: bool = True) -> View:
        """What is there with the arm at `posture` (M, physical units); `obstacles`: (obstacle_size,).

        Not `returning`: on the learned motion, which must come near to what the task is about.
        """


class ClearanceFilter(LeafSystem):
    """Passes the command through, but on the way home it changes the step where the arm would come too near.

    .. pydrake_system::

        name: ClearanceFilter
        input_ports: [posture, desired_posture, alpha, obstacles]
        output_ports: [filtered_posture, clearance]

    Inputs:
        posture: (M,) m_k as sampled at the tick, joint angles in rad first.
        desired_posture: (M,) the command m_k + dm, same unit.
        alpha: (1,) alpha_k: below 1/2, on the learned motion, the command passes unless that is to be filtered too.
        obstacles: what `Map.view` is told; only where the map asks for it.
    Outputs:
        filtered_posture: (M,) m_k + dm' with the dm' nearest to dm such that for every pair of bodies at the distance d
            within WITHIN, d + grad d . dm' - g >= (1 - rate) (d - g), g the gap and the pair's margin: a discrete
            barrier function (Agrawal and Sreenath, RSS 2017). Nearest is counted by how far a joint can move the
            arm: the least sum_j (reach_j (dm'_j - dm_j))^2, so that the hand rather turns than the arm stops. Where
            that dm' makes less than PROGRESS of the way along dm, in rad, the margins are given up: they must not
            keep the arm from home. Where it makes less than SLOW of it, reach_j^2 stands for reach_j, if that dm' is
            not much shorter: the arm's own joints keep their step and the wrist yields, even backwards. So a hand comes
            out from between two things where else it stands; that it never stands is not proven. The other components
            pass.
        clearance: (1,) m, the smallest distance at m_k, at most WITHIN; computed only where it is pulled.

    Where no dm' does, since something pushes from the other side, the nearest one by which no pair within the gap comes
    nearer; where the solver fails, 0. The gradient sees a step's beginning only. So the straight line from m_k to the
    command is proven by conservative advancement: a distance d frees it for d / sum_j reach_j |dm'_j|; what cannot be
    proven to stay `least` away, or PRESENT of the present distance where that is less (OF_LESS where it is below
    `least` already: else the proof is so many small pieces that the arm stands), is cut off. Two bodies that overlap
    already are pushed apart, and have no say in the proof. How near the arm itself comes, which follows the
    command with a lag, is measured.

    Direct feedthrough, no state. No AutoDiff: the minimum is not differentiable where a pair begins to matter, and
    signed distances between a cylinder and most shapes have none in Drake.
    """

    def __init__(
        self,
        map: Map,
        *,
        posture_size: int,
        joints: int,
        lower: np.ndarray,
        upper: np.ndarray,
        max_step: np.ndarray,
        gap: float = 0.01,
        least: float = 0.005,
        rate: float = 0.3,
        learned_motion: bool = False,
    ):
        """
        Args:
            posture_size: M.
            joints: J, the first J components are joint angles.
            lower, upper: (M,) limits of the command.
            max_step: (J,) largest step of a tick, rad.
            gap: distance that the arm keeps, m.
            least: distance that the straight line to each command is proven to keep, m; from nearer see the class.
            rate: share of the distance above `gap` by which a tick may come nearer, in (0, 1].
            learned_motion: filter the learned motion too.
        """
        super().__init__()
        size = require_count("posture_size", posture_size)
        self._joints = require_count("joints", joints, 1, size)
        self._lower, self._upper = require_bounds("lower", lower, "upper", upper, size)
        self._max_step = require_vector("max_step", max_step, joints, minimum=0.0)
        self._gap, self._least = require_positive("gap", gap), require_positive("least", least)
        self._rate = require_positive("rate", rate)
        if not least < gap < WITHIN or rate > 1.0:
            raise ValueError(
                f"least is {least}, gap {gap} and rate {rate}; needed is least < gap < {WITHIN} and rate <= 1: pass "
                "such numbers."
            )
        self._map, self._learned_motion = map, bool(learned_motion)
        reach = require_vector("map.reach", map.reach, joints, minimum=0.0)
        if not reach.all():
            raise ValueError(f"map.reach is {reach}; of each joint it must be greater than 0: pass such numbers.")
        self._weight = np.diag((reach / reach.max()) ** 2)
        self._posture = self.DeclareVectorInputPort("posture", size)
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._obstacles = None
        if map.obstacle_size:
            self._obstacles = self.DeclareVectorInputPort("obstacles", map.obstacle_size)
        inputs = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("filtered_posture", size, self._calc_posture, inputs)
        self.DeclareVectorOutputPort("clearance", 1, self._calc_clearance, inputs)

    def _view(self, context: Context) -> View:
        obstacles = np.empty(0) if self._obstacles is None else self._obstacles.Eval(context)
        return self._map.view(self._posture.Eval(context), obstacles, self._returning(context))

    def _returning(self, context: Context) -> bool:
        return bool(self._alpha.Eval(context)[0] >= GUARD)

    def _calc_clearance(self, context: Context, output: BasicVector) -> None:
        near = self._view(context).near(self._posture.Eval(context)[: self._joints], WITHIN)
        output[0] = near.distances.min(initial=WITHIN)

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        desired = self._desired.Eval(context)
        output.SetFromVector(desired)
        if not self._learned_motion and not self._returning(context):
            return
        joints = self._posture.Eval(context)[: self._joints]
        step = desired[: self._joints] - joints
        view = self._view(context)
        near = view.near(joints, WITHIN)
        filtered = self._proven(view, near, joints, self._kept_away(near, joints, step))
        if filtered is not step:
            output.SetFromVector(np.concatenate((joints + filtered, desired[self._joints :])))

    def _kept_away(self, near: Near, joints: np.ndarray, step: np.ndarray) -> np.ndarray:
        """`step` (J,) where it keeps the distances, else the one nearest to it that does; see the class."""
        bound = -self._rate * (near.distances - self._gap)
        ways = [(bound, -np.inf), (np.minimum(bound, 0.0), -np.inf)]  # 0 keeps the second
        if near.margins.any():
            ways.insert(0, (bound + self._rate * near.margins, PROGRESS * (step @ step)))
        for least, progress in ways:
            if np.all(near.jacobians @ step >= least):
                return step
            found = self._nearest(near.jacobians, least, joints, step, self._weight)
            if found is None or found @ step < progress:
                continue
            if found @ step < SLOW * (step @ step):
                other = self._nearest(near.jacobians, least, joints, step, self._weight**2)
                if other is not None and self._travel(other) >= NOT_SHORTER * self._travel(found):
                    return other
            return found
        return np.zeros(self._joints)

    def _nearest(
        self, jacobians: np.ndarray, least: np.ndarray, joints: np.ndarray, step: np.ndarray, weight: np.ndarray
    ) -> np.ndarray | None:
        """The dm (J,) within the limits, jacobians (n, J) . dm >= least (n,), that is nearest to `step` by `weight`.

        `weight`: (J, J). None where the solver finds none.
        """
        lower = np.maximum(-self._max_step, np.minimum(self._lower[: self._joints] - joints, 0.0))
        upper = np.minimum(self._max_step, np.maximum(self._upper[: self._joints] - joints, 0.0))
        program = MathematicalProgram()
        dm = program.NewContinuousVariables(self._joints)
        program.AddQuadraticErrorCost(weight, step, dm)
        program.AddBoundingBoxConstraint(lower, upper, dm)
        program.AddLinearConstraint(jacobians, least, np.full(len(least), np.inf), dm)
        result = ClarabelSolver().Solve(program)
        return result.GetSolution(dm) if result.is_success() else None

    def _travel(self, step: np.ndarray) -> float:
        """m: no point of the arm moves farther in `step` (J,)."""
        return float(self._map.reach @ np.abs(step))

    def _proven(self, view: View, near: Near, joints: np.ndarray, step: np.ndarray) -> np.ndarray:
        """`step` (J,) where all of it is proven to keep the least distance, else the part of it that is."""
        travel = self._travel(step)
        overlapping = near.pairs[near.distances <= 0.0]
        nearest = near.distances[near.distances > 0.0].min(initial=WITHIN)
        kept = PRESENT if nearest >= self._least else OF_LESS
        least, share = min(self._least, kept * nearest), 0.0
        for _ in range(MOST_PIECES):
            share += (nearest - least) / max(travel, 1e-12)
            if share >= 1.0:
                return step
            nearest = view.nearest(joints + share * step, WITHIN, but=overlapping)
            if nearest - least < RESOLUTION * least:
                break
        return share * step
