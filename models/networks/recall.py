"""Recall heads: the postures of the last N ticks out of the RNN's state alone (Eq. 4)."""

from torch import Tensor, nn


class RecallHeads(nn.Module):
    """State c_k (B, S) to recalled scaled postures m^R_{k-n}, n = 1..N (B, N, posture).

    Args:
        state_size: S.
        posture_size: components of a posture.
        horizon: N, ticks recalled.
        hidden: units of one hidden layer that all heads share; None gives the paper's linear heads.
    """

    def __init__(self, state_size: int, posture_size: int, horizon: int = 10, hidden: int | None = 256) -> None:
        super().__init__()
        self.posture_size, self.horizon, self.hidden = posture_size, horizon, hidden
        size = posture_size * horizon
        self.layers: nn.Module
        if hidden is None:
            self.layers = nn.Linear(state_size, size)
        else:
            self.layers = nn.Sequential(nn.Linear(state_size, hidden), nn.ReLU(), nn.Linear(hidden, size))

    def forward(self, state: Tensor) -> Tensor:
        """(B, S) to (B, N, posture), row n - 1 is the posture n ticks ago."""
        return self.layers(state).unflatten(-1, (self.horizon, self.posture_size))
