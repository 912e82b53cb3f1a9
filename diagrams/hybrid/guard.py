"""The guard surface alpha = 1/2, cut by two directions of posture displacement.

At a moment of an undisturbed run the whole state of the hybrid system is cloned, the arm is displaced by a u + b v at
once, and the real closed loop (camera, networks, detector, physics) runs on for a few ticks. The largest alpha of those
ticks says in which mode that ends: `task` or `return`. Displacements that put the arm into the scene are left out.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from diagrams.episodes.switching import GUARD
from diagrams.hybrid.common import NetworkArguments
from diagrams.world.names import ARM_JOINTS
from models.checks import SMALLEST, Range
from models.errors import InputError

BISECTIONS = 20


@dataclass
class Guard(NetworkArguments):
    """The surface alpha = 1/2 over two directions of posture displacement."""

    grid: int = 41  # points a side, odd
    joints: tuple[int, int] = (1, 4)  # the two directions
    reach: float = 20.0  # deg, to either side
    level: float = 0.20  # the moment: the hand is so near to the can, m
    ticks: int = 3  # from the displacement on, over which the largest alpha is taken
    rays: int = 16  # along which points are bisected

    NAME: ClassVar[str] = "guard"
    RANGES: ClassVar[dict[str, Range]] = {
        "grid": (3, 1001), "ticks": (1, 1000), "rays": (1, 1000), "reach": (SMALLEST, 180.0), "level": (0.001, 1.0),
    }  # fmt: skip

    def run(self) -> int:
        """Scans a grid and bisects along rays; returns 0 if both agree within the grid's resolution, else 1."""
        from tqdm import tqdm

        from diagrams.drawing.guard import save_guard
        from diagrams.hybrid.guard_probe import GuardProbe

        if self.grid % 2 == 0:
            raise InputError(f"--grid {self.grid} is even, so that 0 would not be on it: choose an odd number")
        if len(set(self.joints)) != 2 or not all(1 <= joint <= ARM_JOINTS for joint in self.joints):
            raise InputError(f"--joints {self.joints} are not two different joints: choose from 1 to {ARM_JOINTS}")
        rollout, episode = self.closed_loop()
        probe = GuardProbe(rollout, episode, self.level, self.ticks)
        directions = np.eye(ARM_JOINTS)[[joint - 1 for joint in self.joints]]
        grid = scan(probe, directions, self.reach, self.grid)
        rays = tqdm(2 * np.pi * np.arange(self.rays) / self.rays, desc="bisection", unit="ray", disable=None)
        points = [p for angle in rays if (p := bisect(probe, directions, self.reach, angle)) is not None]
        gamma = float(rollout.policy.gamma)
        setting = {name: getattr(self, name) for name in ("joints", "level", "ticks")}
        found = report(grid, points, gamma) | setting | {"gamma": gamma, "tick_of_the_run": probe.tick}
        self.write(found)
        title = f"alpha over {self.ticks} ticks after a displacement, {self.level:.2f} m before the can"
        save_guard(found, f"{title} (seed {self.seed})", self.out / "guard.png")
        if not points:
            print(f"no ray leaves mode task within {self.reach} deg: choose a larger --reach")
            return 1
        print(
            f"{len(points)} points of the surface, {found['smallest_detected_deg']:.2f} to "
            f"{found['largest_on_surface_deg']:.2f} deg from no displacement; off the grid's by at most "
            f"{found['bisection_error']:.3f} deg (resolution {found['resolution']:.3f})"
        )
        return 0 if holds(found) else 1


@dataclass(frozen=True)
class GuardGrid:
    """alpha and the error over the displacements, row by the second coordinate, NaN where the arm cannot be."""

    coordinates: np.ndarray  # (n,) deg
    alpha: np.ndarray  # (n, n)
    error: np.ndarray  # (n, n)

    @property
    def resolution(self) -> float:
        """Distance of neighbouring points, deg."""
        return float(self.coordinates[1] - self.coordinates[0])


def scan(probe, directions: np.ndarray, reach: float, count: int) -> GuardGrid:
    """The guard on a square grid from -reach to reach (deg), `count` (odd) points a side.

    `probe`: as GuardProbe; `directions`: (2, 7) unit vectors.
    """
    from tqdm import tqdm

    coordinates = np.linspace(-reach, reach, count)
    alpha, error = np.full((2, count, count), np.nan)
    for j, i in tqdm(list(np.ndindex(count, count)), desc="grid", unit="point", disable=None):
        displacement = np.deg2rad(coordinates[[i, j]]) @ directions
        if probe.possible(displacement):
            alpha[j, i], error[j, i] = probe(displacement)
    return GuardGrid(coordinates, alpha, error)


def bisect(probe, directions: np.ndarray, reach: float, angle: float) -> np.ndarray | None:
    """(2,) deg: a point of the guard surface on the ray at `angle` (rad) from no displacement.

    None where the ray's end is no place for the arm, or is in mode `task`.
    """
    ray = np.array([np.cos(angle), np.sin(angle)])
    ray *= reach / np.max(np.abs(ray))

    def at(share: float) -> np.ndarray:
        return np.deg2rad(share * ray) @ directions

    # The ray ends at its last possible point: beyond what the arm would touch or be stopped by, nothing counts.
    shares = np.linspace(0.0, 1.0, 41)
    first_impossible = int(np.argmin([*(probe.possible(at(share)) for share in shares), False]))
    low, high = 0.0, shares[max(first_impossible - 1, 0)]
    if high == 0.0 or probe(at(high))[0] < GUARD:
        return None
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if probe(at(middle))[0] < GUARD else (low, middle)
    return 0.5 * (low + high) * ray


def contour(grid: GuardGrid, gamma: float) -> list[np.ndarray]:
    """The guard surface as the grid has it: lines (n, 2), deg, where the error is `gamma` (alpha = 1/2)."""
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
    """The grid, the share of the modes, and the bisected points' distance to the grid's surface, deg; plain types."""
    lines = contour(grid, gamma)
    known = np.isfinite(grid.alpha)
    sizes = [float(np.linalg.norm(point)) for point in points]
    return {
        "resolution": grid.resolution,
        "bisection_error": max((boundary_distance(lines, point) for point in points), default=None),
        "bisected_points_deg": [point.tolist() for point in points],
        "smallest_detected_deg": min(sizes, default=None),
        "largest_on_surface_deg": max(sizes, default=None),
        "impossible": int(np.sum(~known)),
        "share_task": float(np.mean(grid.alpha[known] < GUARD)) if known.any() else None,
        "coordinates_deg": grid.coordinates.tolist(),
        "alpha": grid.alpha.tolist(),
        "errors": grid.error.tolist(),
    }


def holds(found: dict) -> bool:
    """Whether the bisected points agree with the grid within its resolution."""
    return found["bisection_error"] is not None and found["bisection_error"] <= found["resolution"]
