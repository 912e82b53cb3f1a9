"""A synthetic data set in the layout of the real one: a flat arm moves a coloured disc over a textured background.

Used as a tiny fixture by the tests, and at full size to try training out:
`python tests/models/synthetic.py FILE.h5 --grid 10 --ticks 161 192`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import h5py
import numpy as np

SIZE = 112
METRES_PER_PIXEL = 0.006
WORLD = {"period": 0.1, "camera": [112, 112, 43.0]}  # what its networks take for granted
INITIAL_POSTURE = np.array([0.0, 0.5, 0.0, -0.5, 0.2, 0.3, 0.0, 0.08])
OPEN, CLOSED = 0.08, 0.03
SPOTS = {"left": np.array([-0.2, 0.18]), "right": np.array([-0.2, 0.26])}
HOME = np.array([-0.12, 0.0])
_ROWS, _COLS = np.mgrid[0:SIZE, 0:SIZE].astype(np.float32)


def _pixel(xy: np.ndarray) -> np.ndarray:
    """Pixel (col, row) of a point (2,) in metres."""
    return np.array([SIZE / 2 + xy[1] / METRES_PER_PIXEL, SIZE / 2 + xy[0] / METRES_PER_PIXEL])


def _paint(image: np.ndarray, distance: np.ndarray, colour: tuple[int, int, int]) -> None:
    """Blends a colour into image (112, 112, 3) where the signed distance (112, 112), in pixels, is negative."""
    cover = np.clip(0.5 - distance, 0.0, 1.0)[..., None]
    image *= 1.0 - cover
    image += cover * np.array(colour, np.float32)


def _disc(image: np.ndarray, centre: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
    _paint(image, np.hypot(_COLS - centre[0], _ROWS - centre[1]) - radius, colour)


def _segment(image: np.ndarray, a: np.ndarray, b: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
    d = b - a
    t = np.clip(((_COLS - a[0]) * d[0] + (_ROWS - a[1]) * d[1]) / (d @ d + 1e-9), 0.0, 1.0)
    _paint(image, np.hypot(_COLS - a[0] - t * d[0], _ROWS - a[1] - t * d[1]) - radius, colour)


def background() -> np.ndarray:
    """Textured background, float32 (112, 112, 3), 0..255."""
    grain = np.random.default_rng(7).normal(0.0, 6.0, (SIZE, SIZE, 1)).astype(np.float32)
    waves = 12.0 * np.sin(_COLS / 5.0)[..., None] * np.cos(_ROWS / 9.0)[..., None]
    return np.clip(np.array([150.0, 140.0, 120.0], np.float32) + waves + grain, 0, 255).astype(np.float32)


def render(scene: np.ndarray, hand: np.ndarray, opening: float, can: np.ndarray, other: np.ndarray) -> np.ndarray:
    """One picture, uint8 (112, 112, 3), of the hand, the can and the other can, all (2,) in metres."""
    image = scene.copy()
    for spot in SPOTS.values():
        _disc(image, _pixel(spot), 6.0, (90, 90, 100))
    _disc(image, _pixel(other), 4.0, (200, 40, 40))
    _disc(image, _pixel(can), 4.0, (200, 40, 40))
    base, tip = _pixel(np.array([-0.33, 0.0])), _pixel(hand)
    elbow = 0.5 * (base + tip) + np.array([-9.0, 0.0])
    _segment(image, base, elbow, 5.0, (230, 230, 235))
    _segment(image, elbow, tip - np.array([0.0, 8.0]), 4.0, (220, 220, 230))
    half = 3.0 + 30.0 * opening
    for side in (-1.0, 1.0):
        _segment(image, tip + [side * half, -7.0], tip + [side * half, 0.0], 1.2, (40, 40, 50))
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)


def _posture(hand: np.ndarray, opening: float) -> np.ndarray:
    """A smooth made-up inverse kinematics: (2,) metres to (8,) posture."""
    x, y = (hand - HOME) / 0.2
    joints = INITIAL_POSTURE[:7] + 0.5 * np.array([y, x, 0.5 * x * y, -x, 0.4 * y, 0.6 * x - 0.2 * y, y * y])
    return np.append(joints, opening)


def _path(points: list[np.ndarray], ticks: int, dwell: tuple[int, int]) -> np.ndarray:
    """Minimum-jerk path (ticks, 2) through points with a dwell at both ends."""
    moving = np.array_split(np.arange(ticks - sum(dwell)), len(points) - 1)
    parts = [np.repeat(points[0][None], dwell[0], 0)]
    for a, b, leg in zip(points[:-1], points[1:], moving, strict=True):
        s = (np.arange(len(leg)) + 1.0) / len(leg)
        parts.append(a + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (b - a))
    parts.append(np.repeat(points[-1][None], dwell[1], 0))
    return np.concatenate(parts)


def demonstration(can: np.ndarray, vacant: str, ticks: tuple[int, int], images: bool = True) -> tuple:
    """rgb (T, 112, 112, 3), posture (T, 8), actions (T, 8) of one demonstration with the can at (2,) metres."""
    scene, other = background(), SPOTS["right" if vacant == "left" else "left"]
    dwell = (min(12, ticks[0] // 6), min(15, ticks[0] // 5))
    hand1 = _path([HOME, can + [-0.03, 0], can, HOME], ticks[0], dwell)
    hand2 = _path([HOME, SPOTS[vacant] + [0.03, 0.0], SPOTS[vacant], HOME], ticks[1], dwell)
    move1, move2 = ticks[0] - sum(dwell), ticks[1] - sum(dwell)
    grasp, release = dwell[0] + 2 * move1 // 3, ticks[0] + dwell[0] + 2 * move2 // 3
    hand = np.concatenate([hand1, hand2])
    opening = np.where((np.arange(len(hand)) >= grasp) & (np.arange(len(hand)) < release), CLOSED, OPEN)
    posture = np.stack([_posture(h, o) for h, o in zip(hand, opening, strict=True)])
    rgb = np.zeros((len(hand), SIZE, SIZE, 3), np.uint8)
    for k in range(len(hand) if images else 0):
        at = can if k < grasp else hand[k] if k < release else SPOTS[vacant]
        rgb[k] = render(scene, hand[k], opening[k], at, other)
    return rgb, posture, np.concatenate([posture[1:], posture[-1:]])


def write(path: Path, grid: int = 4, ticks: tuple[int, int] = (50, 60), pitch: float = 0.02) -> Path:
    """Writes grid x grid x 2 demonstrations on a checkerboard of training and validation positions."""
    names: dict[str, list[str]] = {"train": [], "valid": []}
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        cells = [(i, j, v) for i in range(grid) for j in range(grid) for v in ("left", "right")]
        for number, (i, j, vacant) in enumerate(cells):
            can = np.array([0.02 + i * pitch, (j - (grid - 1) / 2) * pitch])
            rgb, posture, actions = demonstration(can, vacant, ticks)
            split = "train" if (i + j) % 2 == 0 else "valid"
            names[split].append(f"demo_{number}")
            demo = data.create_group(f"demo_{number}")
            demo.create_dataset("obs/rgb", data=rgb, compression="lzf", chunks=(16, SIZE, SIZE, 3))
            demo.create_dataset("obs/posture", data=posture)
            demo.create_dataset("actions", data=actions)
            demo.attrs.update(
                num_samples=len(rgb),
                can_xy=can,
                vacant=vacant,
                grid_index=[i, j],
                split=split,
                subtask_starts=[0, ticks[0]],
            )
        data.attrs.update(
            total=len(cells) * sum(ticks),
            env_args=json.dumps({"name": "synthetic"}),
            world=json.dumps(WORLD),
            period=0.1,
            initial_posture=INITIAL_POSTURE,
            content_hash="00" * 32,
            seed=0,
            posture_names=json.dumps([f"joint_{n}" for n in range(7)] + ["opening"]),
        )
        for split, demos in names.items():
            file.create_dataset(f"mask/{split}", data=np.array(demos, "S"))
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path)
    parser.add_argument("--grid", type=int, default=10)
    parser.add_argument("--ticks", type=int, nargs=2, default=(161, 192))
    args = parser.parse_args()
    write(args.path, args.grid, tuple(args.ticks))
