import math

import pytest
import torch

from models.errors import InputError
from models.networks.rnn import GRU, LSTM, MTRNN, RecurrentNetwork, make_rnn


@pytest.mark.parametrize(("name", "state"), [("lstm", 500), ("gru", 250), ("mtrnn", 100)])
def test_shapes_of_table_one(name: str, state: int) -> None:
    rnn = make_rnn(name)
    assert (rnn.input_size, rnn.output_size, rnn.state_size) == (38, 38, state)
    y, after = rnn.step(torch.randn(3, 38), rnn.initial_state(3))
    assert y.shape == (3, 38)
    assert after.shape == (3, state)
    assert not rnn.initial_state(3).any()
    outputs, states = rnn(torch.randn(5, 3, 38), torch.zeros(5, 3, 1, dtype=torch.bool), rnn.initial_state(3))
    assert outputs.shape == (5, 3, 38)
    assert states.shape == (5, 3, state)


def test_lstm_is_torch_s_lstm_cell() -> None:
    torch.manual_seed(0)
    ours, cell = LSTM(8, 30), torch.nn.LSTMCell(38, 250)
    rows = torch.cat([torch.arange(n * 250, n * 250 + 250) for n in (1, 2, 3, 0)])  # torch: input, forget, cell, output
    with torch.no_grad():
        cell.weight_ih.copy_(ours.gates.weight[rows, :38])
        cell.weight_hh.copy_(ours.gates.weight[rows, 38:])
        cell.bias_ih.copy_(ours.gates.bias[rows])
        cell.bias_hh.zero_()
    x, state = torch.randn(4, 38), 0.5 * torch.randn(4, 500)
    _, after = ours.step(x, state)
    h, c = cell(x, (state[:, :250], state[:, 250:]))
    torch.testing.assert_close(after, torch.cat((h, c), 1))


def test_gru_is_torch_s_gru_cell() -> None:
    torch.manual_seed(0)
    ours, cell = GRU(8, 30), torch.nn.GRUCell(38, 250)
    cell.load_state_dict(
        {
            "weight_ih": ours.from_input.weight,
            "bias_ih": ours.from_input.bias,
            "weight_hh": ours.from_hidden.weight,
            "bias_hh": ours.from_hidden.bias,
        }
    )
    x, state = torch.randn(4, 38), 0.5 * torch.randn(4, 250)
    torch.testing.assert_close(ours.step(x, state)[1], cell(x, state))


def test_mtrnn_against_numbers_worked_by_hand() -> None:
    rnn = MTRNN(1, 1, (1, 1))
    with torch.no_grad():
        rnn.to_fast.weight.copy_(torch.tensor([[0.5, -1.0, 2.0, 1.0]]))  # two inputs, fast h, slow h
        rnn.to_fast.bias.fill_(0.25)
        rnn.to_slow.weight.copy_(torch.tensor([[3.0, -2.0]]))  # fast h, slow h
        rnn.to_slow.bias.fill_(-0.5)
        rnn.output.weight.copy_(torch.tensor([[1.0], [2.0]]))
        rnn.output.bias.zero_()
    u_fast, u_slow = 0.3, -0.2
    h_fast, h_slow = math.tanh(0.3), math.tanh(-0.2)
    y, state = rnn.step(torch.tensor([[1.0, 0.5]]), torch.tensor([[u_fast, u_slow]]))
    fast = 0.5 * 0.3 + 0.5 * (0.5 * 1.0 - 1.0 * 0.5 + 2.0 * h_fast + 1.0 * h_slow + 0.25)
    slow = 29 / 30 * -0.2 + (3.0 * h_fast - 2.0 * h_slow - 0.5) / 30
    torch.testing.assert_close(state, torch.tensor([[fast, slow]]))
    torch.testing.assert_close(y, math.tanh(fast) * torch.tensor([[1.0, 2.0]]))


def test_unknown_network_is_named_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'rnn9'.*lstm, gru, mtrnn"):
        make_rnn("rnn9")


def test_what_is_no_recurrent_network_is_refused() -> None:
    with pytest.raises(InputError, match=r"'tests\.models\.outside:NoNetwork' is no RecurrentNetwork"):
        make_rnn("tests.models.outside:NoNetwork")


def test_network_from_outside_closes_its_loop_by_the_inherited_forward() -> None:
    torch.manual_seed(0)
    rnn = make_rnn("tests.models.outside:Elman", 1, 1)
    x, closed = torch.randn(4, 1, 2), torch.zeros(4, 1, 1, dtype=torch.bool)
    closed[2] = True
    with torch.no_grad():
        rnn.output.bias[0] = 3.0
        y, states = rnn(x, closed, rnn.initial_state(1))
        state = rnn.initial_state(1)
        for k in range(4):
            wanted, state = rnn.step(y[1].clamp(-1, 1) if k == 2 else x[k], state)
            torch.testing.assert_close(y[k], wanted)
            torch.testing.assert_close(states[k], state)
    assert y[1, 0, 0] > 1.0


SMALL = {"lstm": lambda: LSTM(3, 4, 6), "gru": lambda: GRU(3, 4, 6), "mtrnn": lambda: MTRNN(3, 4, (5, 2), (1.5, 4.0))}


def loop_inputs(rnn: RecurrentNetwork, ticks: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Three sequences: a loop that opens again, none, one to the end; about half of the predictions are clipped."""
    closed = torch.zeros(ticks, 3, 1, dtype=torch.bool)
    closed[ticks // 4 : -ticks // 3, 0] = closed[ticks // 2 :, 2] = True
    with torch.no_grad():
        rnn.double().output.weight *= 9.0
    return torch.randn(ticks, 3, 7).double(), closed, 0.5 * torch.randn(3, rnn.state_size).double()


@pytest.mark.parametrize("name", SMALL)
def test_written_out_loop_is_autograd_s(name: str) -> None:
    torch.manual_seed(0)
    rnn = SMALL[name]()
    inputs = loop_inputs(rnn, 12)
    weights = torch.randn(12, 3, 7 + rnn.state_size).double()
    results = []
    for forward in (type(rnn).forward, RecurrentNetwork.forward):
        rnn.zero_grad()
        y, states = forward(rnn, *inputs)
        (torch.cat((y, states), -1) * weights).sum().backward()
        results.append([y.detach(), states.detach(), *[parameter.grad.clone() for parameter in rnn.parameters()]])
    assert 0.1 < (results[0][0].abs() > 1).double().mean() < 0.9
    for ours, autograd_s in zip(*results, strict=True):
        torch.testing.assert_close(ours, autograd_s, rtol=1e-6, atol=1e-6)  # the MTRNN's time constants are float32


@pytest.mark.parametrize("name", SMALL)
def test_written_out_gradient_is_that_of_differences(name: str) -> None:
    torch.manual_seed(1)
    rnn = SMALL[name]()
    inputs = loop_inputs(rnn, 6)
    names, values = zip(*rnn.named_parameters(), strict=True)

    def run(*parameters: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.func.functional_call(rnn, dict(zip(names, parameters, strict=True)), inputs)

    assert torch.autograd.gradcheck(run, values)


def test_loop_leaves_its_inputs_as_they_are() -> None:
    rnn = SMALL["gru"]()
    inputs = loop_inputs(rnn, 8)
    before = [part.clone() for part in inputs]
    rnn(*inputs)
    assert all(torch.equal(one, other) for one, other in zip(inputs, before, strict=True))
