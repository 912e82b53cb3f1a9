"""The three recurrent networks of Table I behind one interface: the state goes in and comes out."""

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from models.errors import InputError
from models.networks import NETWORKS
from models.networks.loop import Loop


class RecurrentNetwork(nn.Module, ABC):
    """Predicts the next scaled posture and features from the present ones (Sec. II-B, II-C of the paper).

    A subclass takes posture_size and feature_size and gives a `name` and `step`; no other file has to know it: see
    models/registry.py.

    Attributes:
        name: short, for file names and tables.
        training_defaults: options of `training rnn` that hold where none are given.
        spec: what NETWORKS finds the class by; weight files state it.
        posture_size, feature_size: parts of x and y, posture first.
        state_size: length S of the state; the common initial state c_0 is zero.
    """

    name: str
    training_defaults: ClassVar[dict[str, Any]] = {"steps": 6_000, "posture_weight": 60.0, "learning_rate": 2.5e-3}

    def __init__(self, posture_size: int, feature_size: int, state_size: int, output_from: int) -> None:
        super().__init__()
        self.spec = self.name
        self.posture_size, self.feature_size, self.state_size = posture_size, feature_size, state_size
        self.input_size = self.output_size = posture_size + feature_size
        self.output = nn.Linear(output_from, self.output_size)

    def initial_state(self, batch: int) -> Tensor:
        """c_0 (B, S), zeros."""
        return self.output.weight.new_zeros(batch, self.state_size)

    @abstractmethod
    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One tick: x (B, 38) scaled [m_k, f_k] and c_{k-1} (B, S) to y (B, 38), the prediction of k+1, and c_k."""

    def forward(self, x: Tensor, closed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Runs over T ticks from state (B, S): inputs x (T, B, 38) to y (T, B, 38) and all states (T, B, S).

        Where `closed` (T, B, 1) is True, but at the first tick, the own clipped prediction takes the input's place
        (Eqs. 7, 8 with alpha = 1).
        """
        outputs, states, y = [], [], x[0]
        loops = closed.flatten(1).any(1).tolist()
        for k, (own, data) in enumerate(zip(closed.unbind(0), x.unbind(0), strict=True)):
            y, state = self.step(torch.where(own, y.clamp(-1.0, 1.0), data) if k and loops[k] else data, state)
            outputs.append(y)
            states.append(state)
        return torch.stack(outputs), torch.stack(states)


def _uniform(module: nn.Module, bound: float) -> None:
    for parameter in module.parameters():
        nn.init.uniform_(parameter, -bound, bound)


class LSTM(RecurrentNetwork):
    """LSTM, state [h, c]."""

    name = "lstm"

    def __init__(self, posture_size: int, feature_size: int, units: int = 250) -> None:
        super().__init__(posture_size, feature_size, 2 * units, units)
        self.units = units
        self.gates = nn.Linear(self.input_size + units, 4 * units)  # rows: output, input, forget, cell
        _uniform(self.gates, 1.0 / math.sqrt(units))
        with torch.no_grad():
            self.gates.bias[2 * units : 3 * units] += 1.0  # remembers over a subtask from the first update on

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        h, c = state.split(self.units, 1)
        gates, cell = self.gates(torch.cat((x, h), 1)).split((3 * self.units, self.units), 1)
        o, i, f = torch.sigmoid(gates).split(self.units, 1)
        c = f * c + i * torch.tanh(cell)
        h = o * torch.tanh(c)
        return self.output(h), torch.cat((h, c), 1)

    def forward(self, x: Tensor, closed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """As RecurrentNetwork.forward; the state gets no gradient."""
        h, c = state.split(self.units, 1)
        # tanh(a) = 2 sigmoid(2 a) - 1: one function for all the gates, and tanh is three times as slow.
        twice = torch.ones_like(self.gates.bias)
        twice[3 * self.units :] = 2.0
        from_x, from_h = (self.gates.weight.t() * twice).split((self.input_size, self.units))
        weights = (from_x, from_h, self.gates.bias * twice, self.output.weight.t(), self.output.bias)
        y, h, c = Loop.apply(self, x, closed, h, c, *weights)
        return y, torch.cat((h, c), -1)

    def advance(self, a: Tensor, blocks: tuple[Tensor, ...], m: Tensor) -> tuple[Tensor, Tensor]:
        """As Cell; the memory is c."""
        a.sigmoid_()
        o, i, f, cell = blocks
        m = torch.addcmul((f * m).sub_(i), i, cell, value=2.0)
        return m, o * torch.tanh(m)

    def slopes(self, a: Tensor, before: Tensor, m: Tensor, h: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """As Cell: the output gate alone goes past the memory."""
        o, i, f, cell = a.split(self.units, 2)
        bent = torch.tanh(m)
        by_gates = torch.stack(
            ((2.0 * cell - 1.0) * i * (1.0 - i), before * f * (1.0 - f), 2.0 * i * cell * (1.0 - cell)), 2
        )
        return o * (1.0 - bent.square()), f, (h * (1.0 - o))[:, :, None], by_gates


class GRU(RecurrentNetwork):
    """GRU, state h."""

    name = "gru"

    def __init__(self, posture_size: int, feature_size: int, units: int = 250) -> None:
        super().__init__(posture_size, feature_size, units, units)
        self.units = units
        self.from_input = nn.Linear(self.input_size, 3 * units)  # rows: reset, update, new as torch.nn.GRU
        self.from_hidden = nn.Linear(units, 3 * units)
        _uniform(self.from_input, 1.0 / math.sqrt(units))
        _uniform(self.from_hidden, 1.0 / math.sqrt(units))

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r_x, z_x, n_x = self.from_input(x).split(self.units, 1)
        r_h, z_h, n_h = self.from_hidden(state).split(self.units, 1)
        z = torch.sigmoid(z_x + z_h)
        n = torch.tanh(n_x + torch.sigmoid(r_x + r_h) * n_h)
        h = n + z * (state - n)
        return self.output(h), h

    def forward(self, x: Tensor, closed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """As RecurrentNetwork.forward; the state gets no gradient."""
        # Sums: new by the input, reset, update, new by the hidden; the input has the first three, the hidden the last.
        from_x, x_bias = (part.roll(self.units, 0) for part in (self.from_input.weight, self.from_input.bias))
        bias = F.pad(x_bias, (0, self.units)) + F.pad(self.from_hidden.bias, (self.units, 0))
        weights = (from_x.t(), self.from_hidden.weight.t(), bias, self.output.weight.t(), self.output.bias)
        y, h, _ = Loop.apply(self, x, closed, state, state, *weights)
        return y, h

    def advance(self, a: Tensor, blocks: tuple[Tensor, ...], m: Tensor) -> tuple[Tensor, Tensor]:
        """As Cell; the memory is h."""
        n, r, z, n_h = blocks
        a[:, self.units : 3 * self.units].sigmoid_()
        n.addcmul_(r, n_h).tanh_()
        h = n + z * (m - n)
        return h, h

    def slopes(self, a: Tensor, before: Tensor, m: Tensor, h: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """As Cell."""
        n, r, z, n_h = a.split(self.units, 2)
        by_n = (1.0 - z) * (1.0 - n.square())
        by_sums = torch.stack((by_n, by_n * n_h * r * (1.0 - r), (before - n) * z * (1.0 - z), by_n * r), 2)
        return torch.ones_like(h[0]), z, by_sums[:, :, :0], by_sums


class MTRNN(RecurrentNetwork):
    """Multiple timescale RNN: u <- (1 - 1/tau) u + (1/tau)(weighted inputs), h = tanh(u); state [u_fast, u_slow].

    The fast layer sees the input, itself and the slow layer, the slow layer the fast one and itself, both by the
    previous h; the fast layer gives the output.
    """

    name = "mtrnn"
    # It has a twentieth of the LSTM's weights and spends them on the features unless the posture weighs more.
    # At a rate of 1e-2 it diverges.
    rate: Tensor
    training_defaults: ClassVar[dict[str, Any]] = {"steps": 32_000, "posture_weight": 150.0, "learning_rate": 4e-3}

    def __init__(self, posture_size: int, feature_size: int, sizes=(80, 20), tau=(2.0, 30.0)) -> None:
        """`sizes`: units of the fast and the slow layer; `tau`: their time constants, ticks."""
        fast, slow = sizes
        super().__init__(posture_size, feature_size, fast + slow, fast)
        self.sizes, self.tau = sizes, tau
        self.to_fast = nn.Linear(self.input_size + fast + slow, fast)
        self.to_slow = nn.Linear(fast + slow, slow)
        rate = torch.repeat_interleave(1.0 / torch.tensor(tau), torch.tensor(sizes))  # 1 / tau of each unit
        self.register_buffer("rate", rate, persistent=False)

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        h = torch.tanh(state)
        u_fast, u_slow = state.split(self.sizes, 1)
        u_fast = torch.lerp(u_fast, self.to_fast(torch.cat((x, h), 1)), 1.0 / self.tau[0])
        u_slow = torch.lerp(u_slow, self.to_slow(h), 1.0 / self.tau[1])
        return self.output(torch.tanh(u_fast)), torch.cat((u_fast, u_slow), 1)

    def forward(self, x: Tensor, closed: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """As RecurrentNetwork.forward; the state gets no gradient."""
        from_x, from_h = self.to_fast.weight.split((self.input_size, self.state_size), 1)
        from_h = torch.cat((from_h, self.to_slow.weight))
        bias = torch.cat((self.to_fast.bias, self.to_slow.bias))
        to_y = F.pad(self.output.weight, (0, self.sizes[1]))
        weights = (from_x.t(), from_h.t(), bias, to_y.t(), self.output.bias)
        y, _, u = Loop.apply(self, x, closed, torch.tanh(state), state, *weights)
        return y, u

    def advance(self, a: Tensor, blocks: tuple[Tensor, ...], m: Tensor) -> tuple[Tensor, Tensor]:
        """As Cell; the memory is u."""
        m = torch.lerp(m, a, self.rate)
        return m, torch.tanh(m)

    def slopes(self, a: Tensor, before: Tensor, m: Tensor, h: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """As Cell."""
        by_sums = self.rate.expand_as(h)[:, :, None]
        return 1.0 - h.square(), 1.0 - self.rate, by_sums[:, :, :0], by_sums


def make_rnn(spec: str, posture_size: int = 8, feature_size: int = 30) -> RecurrentNetwork:
    """The network that `spec` names (models.networks.NETWORKS); raises InputError where there is none."""
    network = network_class(spec)(posture_size, feature_size)
    network.spec = spec
    return network


def network_class(spec: str) -> Any:
    """The subclass of RecurrentNetwork that `spec` names; raises InputError where there is none."""
    found = NETWORKS[spec]
    if not (isinstance(found, type) and issubclass(found, RecurrentNetwork)):
        raise InputError(f"the network '{spec}' is no RecurrentNetwork: make it a subclass (models/networks/rnn.py)")
    return found
