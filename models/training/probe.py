"""How many millimetres the features localise the can to, on positions that the autoencoder did not see.

`python -m models.training.probe --data FILE.h5 --encoder cae.safetensors`
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.data.demonstrations import iterate_frames, read_demonstrations
from models.inference import Encoder


@dataclass(kw_only=True)
class ProbeOptions:
    """Localisation of the can by the 30 features, at the first ticks of the validation demonstrations.

    Args:
        data: data set of diagrams/teach.py (HDF5).
        encoder: autoencoder file.
        ticks: first ticks of a demonstration that are read.
        noise: std of Gaussian noise on the features, as the recurrent network meets in training; 0 for none.
        json: also write the result to this file.
    """

    data: Path
    encoder: Path
    ticks: int = 3
    noise: float = 0.0
    json: Path | None = None


def _lift(f: np.ndarray, centres: np.ndarray, width: float) -> np.ndarray:
    """Features (n, 30) with a constant, themselves, and Gaussian bumps around centres."""
    distance = ((f[:, None] - centres[None]) ** 2).sum(-1)
    return np.concatenate([np.ones((len(f), 1)), f, np.exp(-0.5 * distance / width**2)], axis=1)


def _ridge(a: np.ndarray, b: np.ndarray, penalty: float) -> np.ndarray:
    return np.linalg.solve(a.T @ a + penalty * np.eye(a.shape[1]), a.T @ b)


def regress(f_train: np.ndarray, y_train: np.ndarray, f_test: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Ridge regression on radial basis functions, width and penalty by 5-fold cross-validation over groups.

    Args:
        f_train: (n, 30), y_train: (n, d), f_test: (m, 30).
        groups: (n,) group of each training row; a fold never splits one.

    Returns:
        Predictions (m, d).
    """
    mean, std = f_train.mean(0), f_train.std(0) + 1e-6
    f_train, f_test = (f_train - mean) / std, (f_test - mean) / std
    offset = y_train.mean(0)
    spread = np.sqrt(((f_train[:, None] - f_train[None]) ** 2).sum(-1).mean())
    best, choice = np.inf, (1.0, 1.0)
    for width in spread * np.array([0.5, 1.0, 2.0, 4.0]):
        lifted = _lift(f_train, f_train, width)
        for penalty in (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0):
            error = 0.0
            for fold in range(5):
                out = groups % 5 == fold
                weights = _ridge(lifted[~out], y_train[~out] - offset, penalty)
                error += ((lifted[out] @ weights + offset - y_train[out]) ** 2).sum()
            if error < best:
                best, choice = error, (width, penalty)
    weights = _ridge(_lift(f_train, f_train, choice[0]), y_train - offset, choice[1])
    return _lift(f_test, f_train, choice[0]) @ weights + offset


def probe(options: ProbeOptions) -> dict[str, float]:
    """Median, 95th percentile and largest error in mm on validation demonstrations; accuracy of the vacant spot."""
    encoder = Encoder(options.encoder)
    rng = np.random.default_rng(0)
    parts = {}
    for split in ("train", "valid"):
        demos = read_demonstrations(options.data, split)
        frames = iterate_frames(options.data, [d.name for d in demos], options.ticks)
        f = np.concatenate([encoder.encode_batch(rgb) for rgb in frames])
        f += options.noise * rng.standard_normal(f.shape)
        y = np.repeat([[*d.can_xy, 0.1 if d.vacant == "left" else -0.1] for d in demos], options.ticks, axis=0)
        parts[split] = (f, y)
    (f_train, y_train), (f_valid, y_valid) = parts["train"], parts["valid"]
    groups = np.unique(y_train[:, :2].round(4), axis=0, return_inverse=True)[1].reshape(-1)
    guess = regress(f_train, y_train, f_valid, np.random.default_rng(1).permutation(groups.max() + 1)[groups])
    error = 1000.0 * np.linalg.norm(guess[:, :2] - y_valid[:, :2], axis=1)
    return {
        "median_mm": float(np.median(error)),
        "p95_mm": float(np.percentile(error, 95)),
        "max_mm": float(error.max()),
        "vacant_accuracy": float(np.mean((guess[:, 2] > 0) == (y_valid[:, 2] > 0))),
        "least_feature_std": float(f_train.std(0).min()),
        "positions": float(len(error) // options.ticks),
    }


def main(arguments: list[str] | None = None) -> int:
    """Command line. Exit code 2: bad input, one clear line."""
    import tyro

    options = tyro.cli(ProbeOptions, args=arguments, description=__doc__)
    try:
        result = probe(options)
        if options.json is not None:
            options.json.write_text(json.dumps(result, indent=2) + "\n")
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(
        f"can at held-out positions: median {result['median_mm']:.1f} mm, p95 {result['p95_mm']:.1f} mm, "
        f"largest {result['max_mm']:.1f} mm; vacant spot {100 * result['vacant_accuracy']:.1f} % right; "
        f"least std of a feature {result['least_feature_std']:.3f}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
