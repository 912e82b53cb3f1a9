"""A network that another package might bring, and something that is none."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from models.networks.rnn import RecurrentNetwork


class Elman(RecurrentNetwork):
    """Elman's network: h = tanh(W [x, h])."""

    name = "elman"
    training_defaults: ClassVar[dict[str, Any]] = {"steps": 3, "posture_weight": 4.0, "learning_rate": 1e-2}

    def __init__(self, posture_size: int = 8, feature_size: int = 30) -> None:
        super().__init__(posture_size, feature_size, 40, 40)
        self.hidden = nn.Linear(self.input_size + 40, 40)

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        h = torch.tanh(self.hidden(torch.cat((x, state), 1)))
        return self.output(h), h


class NoNetwork:
    name = "none"
