"""Behaviour cloning, as a stock policy of somebody else would come: an MLP on posture and features, and no state.

As a program it trains itself: python -m tests.diagrams.cloned_policy demonstrations.h5 runs/cloned/cloned.npz [UPDATES]
"""

import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from diagrams.world.configuration import World
from models.policy import Decision, Policy, Seen

FILE, USUAL = "CLONED_POLICY", "runs/cloned/cloned.npz"  # the environment variable that names its file
AHEAD, STILL = 3, 0.004  # ticks, rad
JOINTS = np.append(np.ones(7), 0.0)  # are predicted by their step, the opening itself


class Cloned(Policy):
    """Two layers of tanh; answers with a posture of the next ticks."""

    name = "cloned"

    def __init__(self) -> None:
        file = Path(os.environ.get(FILE, USUAL))
        self.initial_posture, self.files = World().initial_posture, (file,)
        with np.load(file) as stored:
            self.encoder_hash = str(stored["encoder"])
            self.layers = [stored[name] for name in sorted(stored.files) if name != "encoder"]
        self.lower, self.upper = self.layers[:2]

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        h = np.append(self.scaling.scale(seen.posture), seen.features)
        for W, b in zip(self.layers[2:-2:2], self.layers[3:-2:2], strict=True):
            h = np.tanh(h @ W + b)
        step = h @ self.layers[-2] + self.layers[-1]
        return Decision(self.scaling.unscale(JOINTS * self.scaling.scale(seen.posture) + step))


def train(data: Path, file: Path, encoder, updates: int = 15_000, hidden: int = 256) -> None:
    """Clones the demonstrations in `data` (teach.py), seen by `encoder`, into `file`."""
    import torch

    from models.data.demonstrations import iterate_frames, read_demonstrations, subtask_ranges
    from models.training.rnn import posture_scaling

    torch.manual_seed(0)
    demos = read_demonstrations(data, "train")
    scaling = posture_scaling(demos, 1.1, 0.3)
    frames = iterate_frames(data, [demo.name for demo in demos])
    rows = []
    for demo, rgb in zip(demos, frames, strict=True):
        features = encoder.encode_batch(rgb)
        for start, stop in subtask_ranges(demo):
            # The posture AHEAD: what answers with the next one stalls where the teacher was slow. Where he stood still
            # is left out, but for the fingers, and for the rest at the end.
            now = np.arange(start, stop)
            wanted = demo.actions[np.minimum(now + AHEAD - 1, stop - 1)].copy()
            moves = np.abs(wanted - demo.actions[now])[:, :7].max(axis=1) > STILL
            wanted[:, 7] = demo.actions[now, 7]
            kept = moves | (wanted[:, 7] != demo.posture[now, 7]) | (now > stop - 14)
            pairs_of = scaling.scale(demo.posture[now]), scaling.scale(wanted), features[now]
            rows.append(np.hstack(pairs_of)[kept])
    pairs = torch.from_numpy(np.concatenate(rows)).float()
    joints = torch.from_numpy(JOINTS).float()
    sizes = (pairs.shape[1] - 8, hidden, hidden, 8)
    layers = [torch.nn.Linear(*pair) for pair in pairwise(sizes)]
    parameters = [p for layer in layers for p in layer.parameters()]
    optimizer = torch.optim.Adam(parameters, 2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        posture, action, features = pairs[torch.randint(len(pairs), (512,))].split((8, 8, sizes[0] - 8), 1)
        # Beside the path, it comes back to it; the hand's opening is a command, which is one of two.
        posture = posture + 0.06 * torch.rand(len(posture), 1) * torch.randn_like(posture) * joints
        h = torch.cat((posture, features + 0.1 * torch.randn_like(features)), 1)
        for layer in layers[:-1]:
            h = torch.tanh(layer(h))
        predicted = layers[-1](h) + posture * joints
        loss = (predicted - action).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    print(f"{len(pairs)} ticks, rms error {loss.item() ** 0.5:.4f}, scaled")
    named = {"encoder": np.array(encoder.hash)}
    named |= {f"a{i}": bound for i, bound in enumerate((scaling.lower, scaling.upper))}
    for i, p in enumerate(parameters):
        named[f"b{i}"] = p.detach().numpy().T.astype(float)
    np.savez(file, **named)


if __name__ == "__main__":
    from diagrams.world.names import ENCODER, WEIGHTS
    from models.inference import Encoder

    train(Path(sys.argv[1]), Path(sys.argv[2]), Encoder(WEIGHTS / ENCODER), *map(int, sys.argv[3:]))
