"""The guard surface alpha = 1/2, cut by two directions of posture displacement.

At a moment of an undisturbed run the whole state of the hybrid system is cloned, the arm is displaced by a u + b v at once, and the real closed
loop (camera, networks, detector, physics) runs on for a few ticks. The largest alpha of those ticks says in which mode that ends: `task` or
`return`. Displacements that put the arm into the scene are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from diagrams.episodes.episode import Episode
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.switching import GUARD as GUARD
from diagrams.world.collisions import CollisionChecker
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CANS
from models.errors import InputError

BISECTIONS = 20


class GuardProbe:
    """alpha after a displacement of the arm, at one moment of one undisturbed episode."""

    def __init__(self, rollout: Rollout, episode: Episode, level: float, ticks: int):
        """Runs `episode` until the hand is nearer to the can than `level` (m), and keeps that state.

        `ticks`: over how many the largest alpha is taken. Raises InputError where the moment does not come within 30 s, or alpha is high before.
        """
        self._rollout, self._ticks = rollout, ticks
        self._period = rollout.world.timing.period
        # Half a plant step before a tick: later in the tick the servo would draw the arm back before its posture is sampled.
        self._before = 0.5 * rollout.world.timing.time_step
        rollout.prepare(episode)
        station, simulator = rollout.station, rollout.simulator
        context = simulator.get_mutable_context()
        distance = station.GetOutputPort("approach_distance")
        for k in range(round(30.0 / self._period)):
            simulator.AdvanceTo((k + 1) * self._period - self._before)
            if self._alpha(context) >= GUARD:
                raise InputError(
                    f"the run is in mode return {context.get_time():.1f} s after its start: choose another --seed"
                )
            if distance.Eval(station.GetMyContextFromRoot(context))[0] < level:
                break
        else:
            raise InputError(f"the hand does not come within {level} m of the can in 30 s: choose a larger --level")
        self.tick = k
        self._kept = context.Clone()
        plant_context = station.plant.GetMyContextFromRoot(self._kept)
        self.joints = station.plant.GetPositions(plant_context, station.arm).copy()
        self._clearance = CollisionChecker(gap=0.0)
        can = station.GetOutputPort("can_poses").Eval(station.GetMyContextFromRoot(self._kept))
        if can[6] > 1.5 * CAN_HALF_HEIGHT:
            raise InputError(f"{CANS[0]} is already in the hand {level} m before it: choose a larger --level")
        self._clearance.set_scene(can[4:6], episode.vacant)
        self._lower = station.plant.GetPositionLowerLimits()[:ARM_JOINTS]
        self._upper = station.plant.GetPositionUpperLimits()[:ARM_JOINTS]

    def possible(self, displacement: np.ndarray) -> bool:
        """Whether the arm, displaced by `displacement` (7, rad), is within its limits and touches nothing."""
        joints = self.joints + displacement
        return bool(
            np.all(joints >= self._lower)
            and np.all(joints <= self._upper)
            and self._clearance.first_touch(joints) is None
        )

    def __call__(self, displacement: np.ndarray) -> tuple[float, float]:
        """Largest alpha and largest error l_n / r_n over the ticks after a displacement (7, rad)."""
        simulator, station = self._rollout.simulator, self._rollout.station
        simulator.reset_context(self._kept.Clone())
        context = simulator.get_mutable_context()
        plant_context = station.plant.GetMyMutableContextFromRoot(context)
        station.plant.SetPositions(plant_context, station.arm, self.joints + displacement)
        alphas, errors = [], []
        errors_port = self._rollout.controller.GetOutputPort("errors")
        for k in range(1, self._ticks + 1):
            simulator.AdvanceTo((self.tick + k + 1) * self._period - self._before)
            alphas.append(self._alpha(context))
            errors.append(np.max(errors_port.Eval(self._rollout.controller.GetMyContextFromRoot(context))))
        return max(alphas), float(max(errors))

    def _alpha(self, context: Context) -> float:
        controller = self._rollout.controller
        return float(controller.GetOutputPort("alpha").Eval(controller.GetMyContextFromRoot(context))[0])


@dataclass(frozen=True)
class GuardGrid:
    """What was found: coordinates (n,), deg; `alpha`, `error` (n, n), row by the second coordinate, NaN where the arm cannot be."""

    coordinates: np.ndarray
    alpha: np.ndarray
    error: np.ndarray

    @property
    def resolution(self) -> float:
        """Distance of neighbouring points, deg."""
        return float(self.coordinates[1] - self.coordinates[0])


def scan(
    probe, directions: np.ndarray, reach: float, count: int, on_point: Callable[[], object] = lambda: None
) -> GuardGrid:
    """Evaluates the guard on a square grid.

    Args:
        probe: see GuardProbe (`possible(displacement)`, `probe(displacement) -> (alpha, error)`).
        directions: (2, 7) unit vectors.
        reach: the coordinates go from -reach to reach, deg; count: points a side, odd, so that 0 is among them.
        on_point: called after each point.
    """
    coordinates = np.linspace(-reach, reach, count)
    alpha, error = np.full((2, count, count), np.nan)
    for j, b in enumerate(coordinates):
        for i, a in enumerate(coordinates):
            displacement = np.deg2rad([a, b]) @ directions
            if probe.possible(displacement):
                alpha[j, i], error[j, i] = probe(displacement)
            on_point()
    return GuardGrid(coordinates, alpha, error)


def bisect(probe, directions: np.ndarray, reach: float, angle: float) -> np.ndarray | None:
    """(2,) deg: a point of the guard surface on the ray at `angle` (rad) from no displacement; None where its end is no place for the arm
    or is in mode `task`."""
    ray = np.array([np.cos(angle), np.sin(angle)])
    ray *= reach / np.max(np.abs(ray))
    high = 1.0
    # The ray's last possible point: with what the arm would touch or be stopped by beyond it, only what is before counts.
    shares = np.linspace(0.0, 1.0, 41)
    possible = [probe.possible(np.deg2rad(share * ray) @ directions) for share in shares]
    if not all(possible):
        high = shares[max(int(np.argmin(possible)) - 1, 0)]
    low = 0.0
    if high == 0.0 or probe(np.deg2rad(high * ray) @ directions)[0] < GUARD:
        return None
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if probe(np.deg2rad(middle * ray) @ directions)[0] < GUARD:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high) * ray


def contour(grid: GuardGrid, gamma: float) -> list[np.ndarray]:
    """The guard surface as the grid has it: lines (n, 2), deg, interpolated between its points (alpha = 1/2 where the error is `gamma`)."""
    from contourpy import contour_generator

    values = np.ma.masked_invalid(np.log(np.maximum(grid.error, 1e-9) / gamma))
    lines: Any = contour_generator(grid.coordinates, grid.coordinates, values).lines(0.0)
    return [np.asarray(line) for line in lines]


def boundary_distance(lines: list[np.ndarray], point: np.ndarray) -> float:
    """Distance of `point` (2, deg) to the nearest of the `lines` of `contour`, deg; infinite without one."""
    best = np.inf
    for line in lines:
        start, along = line[:-1], np.diff(line, axis=0)
        length = np.maximum(np.sum(along**2, axis=1), 1e-18)
        share = np.clip(np.sum((point - start) * along, axis=1) / length, 0.0, 1.0)
        best = min(best, float(np.min(np.linalg.norm(point - start - share[:, None] * along, axis=1))))
    return best


def report(grid: GuardGrid, points: list[np.ndarray], gamma: float) -> dict:
    """Resolution, share of the modes and the bisected points' distance to the grid's surface, deg; plain types."""
    lines = contour(grid, gamma)
    distances = [boundary_distance(lines, point) for point in points]
    known = np.isfinite(grid.alpha)
    task = grid.alpha[known] < GUARD
    sizes = [float(np.linalg.norm(point)) for point in points]
    return {
        "resolution": grid.resolution,
        "bisection_error": max(distances) if distances else None,
        "bisected_points_deg": [point.tolist() for point in points],
        "bisection_errors": distances,
        "bisection_precision": float(grid.coordinates[-1] * np.sqrt(2) / 2**BISECTIONS),
        "smallest_detected_deg": min(sizes, default=None),
        "largest_on_surface_deg": max(sizes, default=None),
        "points": int(grid.alpha.size),
        "impossible": int(np.sum(~known)),
        "share_task": float(np.mean(task)) if known.any() else None,
    }


def holds(found: dict) -> bool:
    """Whether the bisected points agree with the grid within its resolution."""
    return found["bisection_error"] is not None and found["bisection_error"] <= found["resolution"]


def save_guard(
    grid: GuardGrid, points: list[np.ndarray], labels: tuple[str, str], gamma: float, title: str, path: Path
) -> None:
    """The filled contours of the largest error over gamma (alpha = 1/2 where it is 1), the modes' regions and the bisected points."""
    from diagrams.drawing.style import BLUE, RED, new_figure, save

    figure, axis = new_figure(figsize=(7.6, 6.2))
    x = grid.coordinates
    values = np.ma.masked_invalid(np.log10(np.maximum(grid.error, 1e-9) / gamma))
    reach = max(float(np.abs(values).max()) if values.count() else 1.0, 0.1)
    filled = axis.contourf(x, x, values, levels=np.linspace(-reach, reach, 25), cmap="RdBu_r")
    figure.colorbar(filled, ax=axis, label=r"$\log_{10}\,\max_n (l_n/r_n)\,/\,\gamma$")
    if values.count() and values.min() < 0 < values.max():
        axis.contour(x, x, values, levels=[0.0], colors="k", linewidths=1.8)
    for mode, colour in (("task", BLUE), ("return", RED)):
        chosen = np.isfinite(grid.alpha) & ((grid.alpha < GUARD) if mode == "task" else (grid.alpha >= GUARD))
        if chosen.any():
            # The point of the region that is farthest from everything else, and from the frame, carries the name.
            inside, others = np.argwhere(chosen), np.argwhere(~np.pad(chosen, 1)) - 1
            far = [np.min(np.linalg.norm(others - point, axis=1)) for point in inside]
            j, i = inside[int(np.argmax(far))]
            axis.text(
                x[i], x[j], mode, ha="center", va="center", color=colour, fontsize=13, weight="bold",
                bbox={"facecolor": "white", "alpha": 0.75, "lw": 0, "pad": 2},
            )  # fmt: skip
    if points:
        axis.plot(*np.array(points).T, "o", color="k", mfc="yellow", ms=5, label=r"$\alpha = 1/2$ by bisection")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), fontsize=8)
    axis.set_facecolor("0.85")  # where the arm cannot be
    axis.set_xlabel(labels[0])
    axis.set_ylabel(labels[1])
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=10)
    save(figure, path)
