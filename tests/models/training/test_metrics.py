import numpy as np
import pytest
import torch

from models.data.sequences import SequencePack
from models.networks.rnn import RecurrentNetwork
from models.training.metrics import validate
from tests.models.conftest import make_policy
from tests.models.data.test_sequences import random_pack


def rms(squares: list[np.ndarray]) -> float:
    return float(np.sqrt(np.concatenate([part.mean(axis=1) for part in squares]).mean()))


def test_figures_of_a_network_that_always_predicts_zero() -> None:
    """Every figure can be worked out from the data alone."""
    rnn, pack = make_policy("gru").rnn, random_pack()
    torch.nn.init.zeros_(rnn.output.weight)
    torch.nn.init.zeros_(rnn.output.bias)
    found = validate(rnn, pack, 7)
    lengths = pack.length.tolist()
    m, errors = pack.x[..., :7].double().numpy(), pack.target[..., :7].double().numpy() ** 2
    features = pack.target[..., 8:].double().numpy() ** 2
    ends = [(errors[i], features[i], n) for i, n in enumerate(lengths)]
    assert found["open"] == pytest.approx(rms([e[:n] for e, _, n in ends]), rel=1e-5)
    assert found["feature"] == pytest.approx(rms([f[:n] for _, f, n in ends]), rel=1e-5)
    assert found["auto"] == pytest.approx(rms([e[40:n] for e, _, n in ends]), rel=1e-5)
    assert found["rest"] == pytest.approx(rms([e[n : n + 10] for e, _, n in ends]), rel=1e-5)
    wanted, gone = m[:, 10] - m[:, 0], -m[:, 0]
    share = (wanted * gone).sum(1) / (wanted**2).sum(1)
    assert found["start"] == pytest.approx(np.quantile(share, 0.05), rel=1e-4)


class Mover(RecurrentNetwork):
    """Commands every component `speed` further than it is, and recalls nothing."""

    name = "mover"

    def __init__(self, speed: float) -> None:
        super().__init__(8, 30, 1, 1)
        self.speed = speed

    def step(self, x: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return x + self.speed, state


@pytest.mark.parametrize(
    ("speed", "done", "start", "follow"),
    [(0.01, 1.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.005, 0.0, 0.5, 0.005 / 2**0.5)],  # every other tick between two
)
def test_rollout_follows_a_ramp_as_fast_as_the_network_commands(
    speed: float, done: float, start: float, follow: float
) -> None:
    ramp = 0.01 * torch.arange(61.0)[None, :, None].expand(3, 61, 8)
    data = torch.cat((ramp, torch.zeros(3, 61, 30)), -1)
    pack = SequencePack(data[:, :-1], data[:, 1:], torch.full((3,), 60), 8)
    found = validate(Mover(speed), pack, 7)
    assert found["done"] == done
    assert found["start"] == pytest.approx(start, abs=1e-5)
    assert found["follow"] == pytest.approx(follow, abs=1e-5)
    assert found["open"] == pytest.approx(0.01 - speed, abs=1e-6)
