"""The LSTM's training loop over ticks, with its backward pass written out.

Autograd over some fifteen small operations a tick costs more than their arithmetic. Here the products that need not wait
for the tick before are taken once for all ticks. Same numbers as LSTM.step called in a loop: a test compares them.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class LstmLoop(torch.autograd.Function):
    """x (T, B, n), closed (T, B, 1), h and c (B, H), and the LSTM's parameters to y (T, B, m) and states (T, B, 2 H).

    Rows of `gates`: output, input, forget, cell. No gradients to x, h and c: they are data.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        closed: Tensor,
        h: Tensor,
        c: Tensor,
        gates: Tensor,
        gates_bias: Tensor,
        output: Tensor,
        output_bias: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Ticks where any sequence is closed take its own clipped prediction as that sequence's input."""
        ticks, batch, inputs = x.shape
        size = h.shape[1]
        from_x, from_h, to_y = gates[:, :inputs].t().contiguous(), gates[:, inputs:].t().contiguous(), output.t()
        loops = closed.flatten(1).any(1).tolist()
        loops[0] = False  # there is no prediction yet
        x = x.clone()
        activation = torch.addmm(gates_bias, x.view(-1, inputs), from_x).view(ticks, batch, -1)
        y = x.new_empty(ticks, batch, len(output))
        hs, cs = x.new_empty(2, ticks + 1, batch, size)
        hs[0], cs[0] = h, c
        tanh_c = torch.empty_like(cs[1:])
        # Lists of views: taking one out of a tensor at each tick would cost as much as the arithmetic on it.
        h_list, c_list, tanh_list, y_list, x_list, closed_list = (a.unbind(0) for a in (hs, cs, tanh_c, y, x, closed))
        sigmoids, cells = activation[..., : 3 * size].unbind(0), activation[..., 3 * size :].unbind(0)
        parts = [row.unbind(1) for row in activation.view(ticks, batch, 4, size).unbind(0)]
        for k, row in enumerate(activation.unbind(0)):
            if loops[k]:
                torch.addmm(output_bias, h_list[k], to_y, out=y_list[k - 1])
                torch.where(closed_list[k], y_list[k - 1].clamp(-1.0, 1.0), x_list[k], out=x_list[k])
                torch.addmm(gates_bias, x_list[k], from_x, out=row)
            row.addmm_(h_list[k], from_h)
            sigmoids[k].sigmoid_()
            cells[k].tanh_()
            o, i, f, g = parts[k]
            torch.mul(f, c_list[k], out=c_list[k + 1]).addcmul_(i, g)
            torch.tanh(c_list[k + 1], out=tanh_list[k])
            torch.mul(o, tanh_list[k], out=h_list[k + 1])
        torch.addmm(output_bias, hs[1:].view(-1, size), to_y, out=y.view(-1, len(output)))
        ctx.save_for_backward(x, closed, hs, cs, tanh_c, activation, y, gates, output)
        ctx.loops = loops
        return y, torch.cat((hs[1:], cs[1:]), -1)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_y: Tensor, grad_states: Tensor) -> tuple[Tensor | None, ...]:
        """Backpropagation through time."""
        x, closed, hs, cs, tanh_c, activation, y, gates, output = ctx.saved_tensors
        ticks, batch, inputs = x.shape
        size = hs.shape[2]
        from_x, from_h = gates[:, :inputs].contiguous(), gates[:, inputs:].contiguous()
        o, i, f, g = activation.view(ticks, batch, 4, size).unbind(2)
        # What a gradient of c (or of h) turns into at each gate, for all ticks at once.
        by_c = torch.stack((g * i * (1 - i), cs[:-1] * f * (1 - f), i * (1 - g * g)), 2)
        by_h, h_to_c = tanh_c * o * (1 - o), o * (1 - tanh_c * tanh_c)
        inside = closed[1:] & (y[:-1].abs() < 1.0)
        grad_y = grad_y.clone()
        grad_h = (grad_y.view(-1, len(output)) @ output).view(ticks, batch, size) + grad_states[..., :size]
        grad_gates = torch.empty_like(activation)
        split = grad_gates.view(ticks, batch, 4, size)
        rows = [
            a.unbind(0)
            for a in (
                by_c,
                by_h,
                h_to_c,
                f,
                grad_h,
                grad_states[..., size:],
                grad_gates,
                split[:, :, 0],
                split[:, :, 1:],
                inside,
                grad_y,
            )
        ]
        by_c_k, by_h_k, h_to_c_k, f_k, grad_h_k, grad_c_k, gates_k, output_gate_k, others_k, inside_k, grad_y_k = rows
        dh, dc = grad_h_k[-1], grad_c_k[-1].clone()
        for k in range(ticks - 1, -1, -1):
            dc.addcmul_(dh, h_to_c_k[k])
            torch.mul(dh, by_h_k[k], out=output_gate_k[k])
            torch.mul(dc[:, None], by_c_k[k], out=others_k[k])
            if k == 0:
                break
            dh = torch.addmm(grad_h_k[k - 1], gates_k[k], from_h)
            dc = torch.addcmul(grad_c_k[k - 1], dc, f_k[k])
            if ctx.loops[k]:
                back = (gates_k[k] @ from_x).mul_(inside_k[k - 1])
                grad_y_k[k - 1].add_(back)
                dh.addmm_(back, output)
        flat, flat_y, outputs = grad_gates.view(ticks * batch, -1), grad_y.view(ticks * batch, -1), hs[1:]
        grad_gates_weight = torch.cat((flat.t() @ x.view(-1, inputs), flat.t() @ hs[:-1].reshape(-1, size)), 1)
        return (
            None,
            None,
            None,
            None,
            grad_gates_weight,
            flat.sum(0),
            flat_y.t() @ outputs.reshape(-1, size),
            flat_y.sum(0),
        )
