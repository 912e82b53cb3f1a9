"""Small perceptrons: trained by torch, run by numpy alone."""

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np


def run_perceptron(layers: Sequence[tuple[np.ndarray, np.ndarray]], rows: np.ndarray) -> np.ndarray:
    """(n, out) float32 of rows (n, in): each layer is (weights (out, in), bias (out,)), ReLU after all but the last."""
    rows = np.asarray(rows, np.float32)
    for weights, bias in layers[:-1]:
        rows = np.maximum(rows @ weights.T + bias, 0.0)
    weights, bias = layers[-1]
    return rows @ weights.T + bias


def random_layers(sizes: Sequence[int], rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Layers of these sizes, He's initialisation, float32."""
    return [
        (rng.normal(0.0, np.sqrt(2.0 / a), (b, a)).astype(np.float32), np.zeros(b, np.float32))
        for a, b in itertools.pairwise(sizes)
    ]


def to_arrays(name: str, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> dict[str, np.ndarray]:
    """The layers as a file keeps them: name.0.weights, name.0.bias, ..."""
    found: dict[str, np.ndarray] = {}
    for i, (weights, bias) in enumerate(layers):
        found |= {f"{name}.{i}.weights": weights, f"{name}.{i}.bias": bias}
    return found


def of_arrays(name: str, arrays: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """What `to_arrays` gave; raises ValueError where that is no perceptron."""
    layers: list[tuple[np.ndarray, np.ndarray]] = []
    while f"{name}.{len(layers)}.weights" in arrays:
        stem = f"{name}.{len(layers)}"
        weights, bias = (np.asarray(arrays.get(f"{stem}.{part}", 0.0), np.float32) for part in ("weights", "bias"))
        if weights.ndim != 2 or bias.shape != weights.shape[:1] or (layers and len(layers[-1][1]) != weights.shape[1]):
            raise ValueError(f"the layer {stem} has the shapes {weights.shape} and {bias.shape}: fit again.")
        layers.append((weights, bias))
    if not layers:
        raise ValueError(f"there is no layer {name}.0: fit again.")
    return layers


def train_perceptron(
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    batch: Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]],
    updates: int,
    seed: int,
    rate: float = 1e-3,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Trains `layers` by Adam on mean squares; the rate falls to 0 by a cosine. Needs torch; the same seed, the same
    bits on one thread.

    Args:
        batch: inputs (b, in) and targets (b, out) of an update, drawn by the generator that it is given.
        updates: how many.
    """
    import torch
    from tqdm import tqdm

    rng, threads = np.random.default_rng(seed), torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        parameters = [torch.tensor(array, requires_grad=True) for layer in layers for array in layer]
        optimiser = torch.optim.Adam(parameters, rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
        for _ in tqdm(range(updates), desc="perceptron", unit="update", leave=False, disable=None):
            rows, targets = (torch.tensor(array, dtype=torch.float32) for array in batch(rng))
            for i in range(0, len(parameters), 2):
                rows = torch.nn.functional.linear(rows, parameters[i], parameters[i + 1])
                rows = rows if i + 2 == len(parameters) else torch.relu(rows)
            loss = torch.nn.functional.mse_loss(rows, targets)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    finally:
        torch.set_num_threads(threads)
    arrays = [parameter.detach().numpy() for parameter in parameters]
    return list(zip(arrays[::2], arrays[1::2], strict=True))
