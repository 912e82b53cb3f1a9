"""A policy of one's own (models/policy.py) with the face of a StoredPolicy: recall heads learn on its states."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.errors import InputError
from models.files.graphs import write_graph
from models.networks.onnx_export import heads_graph
from models.networks.recall import RecallHeads
from models.policy import Policy


class SteppedPolicy(nn.Module):
    """Runs a policy over sequences as a RecurrentNetwork is run; without gradients, in numpy, on the CPU."""

    start: Tensor

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy, self.posture_size, self.state_size = policy, policy.posture_size, policy.state_size
        self.register_buffer("start", torch.from_numpy(np.asarray(policy.initial_state)).float(), persistent=False)

    def initial_state(self, batch: int) -> Tensor:
        """c_0 (B, S)."""
        return self.start.expand(batch, -1)

    def forward(self, x: Tensor, closed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """See RecurrentNetwork.forward."""
        inputs, own = x.double().cpu().numpy(), closed.squeeze(-1).cpu().numpy()
        outputs, states = np.empty(inputs.shape), np.empty((*inputs.shape[:2], self.state_size))
        for b, hidden in enumerate(state.double().cpu().numpy()):
            for k in range(len(inputs)):
                given = np.clip(outputs[k - 1, b], -1.0, 1.0) if k and own[k, b] else inputs[k, b]
                outputs[k, b], hidden, _ = self.policy.step(given, hidden)
                states[k, b] = hidden
        return tuple(torch.from_numpy(part).float().to(x.device) for part in (outputs, states))  # type: ignore[return-value]


class OwnEncoder:
    """The `encode` of a policy with the face of an Encoder."""

    def __init__(self, policy: Any) -> None:
        self.hash, self._encode = policy.hash, policy.encode

    def encode_batch(self, rgb: np.ndarray) -> np.ndarray:
        """uint8 (B, 112, 112, 3) to (B, F)."""
        return np.array([self._encode(picture) for picture in rgb], float)


class OwnStates:
    """What RecallTraining needs of a policy.

    Attributes: rnn, recall: as of a StoredPolicy; metadata; what is not here is the policy's own.
    """

    def __init__(self, policy: Policy) -> None:
        """Raises InputError for a policy without a state, and for one that looks at the picture itself."""
        if not policy.state_size:
            raise InputError(f"the policy '{policy.name}' has no hidden state to recall from: choose another detector")
        if policy.looks:
            raise InputError(f"the policy '{policy.name}' looks at the picture itself: give it `encode` to train heads")
        self.rnn, self.recall, self.metadata = SteppedPolicy(policy), None, dict[str, Any]()
        self.name, self.hash, self.scaling = policy.name, policy.hash, policy.scaling
        self.initial_posture, self.encoder_hash = np.asarray(policy.initial_posture, float), policy.encoder_hash

    recall: RecallHeads | None

    def save(self, path: Path) -> None:
        """Writes the heads, for that policy alone."""
        assert self.recall is not None
        write_graph(path, heads_graph(self.recall, self.rnn.state_size), {"kind": "recall", "policy": self.hash})
