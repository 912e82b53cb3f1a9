"""How many millimetres the features localise the can to, on positions that the encoder did not see."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.checks import require_apart, require_number
from models.command_line import require_writable
from models.data.demonstrations import iterate_frames, read_demonstrations
from models.inference import Encoder


@dataclass(kw_only=True)
class ProbeOptions:
    """Tells to how many millimetres the features localise the can in the validation demonstrations' first ticks.

    A regression from the features to the can's position is fitted on the training demonstrations.

    Args:
        data: data set of diagrams/teach.py (HDF5).
        encoder: file of `training export`.
        ticks: first ticks of a demonstration that are read.
        json: also write the result to this file.
    """

    data: Path
    encoder: Path
    ticks: int = 3
    json: Path | None = None


def regress(f_train: np.ndarray, y_train: np.ndarray, f_test: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Kernel ridge regression with Gaussian kernels, their width and penalty by cross-validation in 5 folds or fewer.

    From f_train (n, 30) and y_train (n, d) to predictions (m, d) for f_test (m, 30); a fold never splits one of the
    groups (n,).
    """
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.model_selection import GridSearchCV, GroupKFold
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    # Of standardised features the mean square distance is 2 n: kernels of 1/2, 1, 2, 4 and 8 times that width.
    widths = 2.0 * f_train.shape[1] * np.array([0.5, 1.0, 2.0, 4.0, 8.0]) ** 2
    grid = {"kernelridge__gamma": 0.5 / widths, "kernelridge__alpha": 10.0 ** np.arange(-6, 2)}
    folds = GroupKFold(min(5, len(np.unique(groups))))
    pipeline = make_pipeline(StandardScaler(), KernelRidge(kernel="rbf"))
    search = GridSearchCV(pipeline, grid, scoring="neg_mean_squared_error", cv=folds)
    offset = y_train.mean(0)
    return search.fit(f_train, y_train - offset, groups=groups).predict(f_test) + offset


def run_probe(options: ProbeOptions) -> None:
    """Prints the errors on validation demonstrations, mm, and the accuracy of the vacant spot; writes options.json."""
    require_number("--ticks", options.ticks, 1, 1000)
    if options.json is not None:
        require_writable(options.json)
        require_apart({"--json": options.json}, {"--data": options.data, "--encoder": options.encoder})
    encoder = Encoder(options.encoder)
    parts = {}
    for split in ("train", "valid"):
        demos = read_demonstrations(options.data, split)
        frames = iterate_frames(options.data, [d.name for d in demos], options.ticks)
        f = np.concatenate([encoder.encode_batch(rgb) for rgb in frames])
        y = np.repeat([[*d.can_xy, 0.1 if d.vacant == "left" else -0.1] for d in demos], options.ticks, axis=0)
        parts[split] = (f, y)
    (f_train, y_train), (f_valid, y_valid) = parts["train"], parts["valid"]
    groups = np.unique(y_train[:, :2].round(4), axis=0, return_inverse=True)[1].reshape(-1)
    guess = regress(f_train, y_train, f_valid, np.random.default_rng(1).permutation(groups.max() + 1)[groups])
    error = 1000.0 * np.linalg.norm(guess[:, :2] - y_valid[:, :2], axis=1)
    result = {
        "median_mm": float(np.median(error)),
        "p95_mm": float(np.percentile(error, 95)),
        "max_mm": float(error.max()),
        "vacant_accuracy": float(np.mean((guess[:, 2] > 0) == (y_valid[:, 2] > 0))),
        "least_feature_std": float(f_train.std(0).min()),
        "positions": float(len(error) // options.ticks),
    }
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + "\n")
    print(
        f"can at held-out positions: median {result['median_mm']:.1f} mm, p95 {result['p95_mm']:.1f} mm, "
        f"largest {result['max_mm']:.1f} mm; vacant spot {100 * result['vacant_accuracy']:.1f} % right; "
        f"least std of a feature {result['least_feature_std']:.3f}"
    )
