"""The GRU's training loop over ticks, with its backward pass written out, for the reason that lstm_loop.py gives.

Same numbers as GRU.step called in a loop: a test compares them.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class GruLoop(torch.autograd.Function):
    """x (T, B, n), closed (T, B, 1), h (B, H), and the GRU's parameters to y (T, B, m) and states (T, B, H).

    Rows of the weights: reset, update, new. No gradients to x and h: they are data.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        closed: Tensor,
        h: Tensor,
        by_x: Tensor,
        by_x_bias: Tensor,
        by_h: Tensor,
        by_h_bias: Tensor,
        output: Tensor,
        output_bias: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Ticks where any sequence is closed take its own clipped prediction as that sequence's input."""
        ticks, batch, inputs = x.shape
        size = h.shape[1]
        from_x, from_h, to_y = by_x.t().contiguous(), by_h.t().contiguous(), output.t()
        loops = closed.flatten(1).any(1).tolist()
        loops[0] = False  # there is no prediction yet
        x = x.clone()
        seen = torch.addmm(by_x_bias, x.view(-1, inputs), from_x).view(ticks, batch, -1)
        y = x.new_empty(ticks, batch, len(output))
        hs = x.new_empty(ticks + 1, batch, size)
        hs[0] = h
        gates = x.new_empty(ticks, batch, 2 * size)
        recalled, new = x.new_empty(2, ticks, batch, size)
        for k in range(ticks):
            if loops[k]:
                torch.addmm(output_bias, hs[k], to_y, out=y[k - 1])
                torch.where(closed[k], y[k - 1].clamp(-1.0, 1.0), x[k], out=x[k])
                torch.addmm(by_x_bias, x[k], from_x, out=seen[k])
            held = torch.addmm(by_h_bias, hs[k], from_h)
            torch.add(seen[k, :, : 2 * size], held[:, : 2 * size], out=gates[k]).sigmoid_()
            r, z = gates[k].split(size, 1)
            recalled[k] = held[:, 2 * size :]
            torch.addcmul(seen[k, :, 2 * size :], r, recalled[k], out=new[k]).tanh_()
            torch.lerp(new[k], hs[k], z, out=hs[k + 1])
        torch.addmm(output_bias, hs[1:].view(-1, size), to_y, out=y.view(-1, len(output)))
        ctx.save_for_backward(x, closed, hs, gates, recalled, new, y, by_x, by_h, output)
        ctx.loops = loops
        return y, hs[1:].clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_y: Tensor, grad_states: Tensor) -> tuple[Tensor | None, ...]:
        """Backpropagation through time."""
        x, closed, hs, gates, recalled, new, y, by_x, by_h, output = ctx.saved_tensors
        ticks, batch, inputs = x.shape
        size = hs.shape[2]
        r, z = gates.split(size, 2)
        # What a gradient of h turns into before each nonlinearity, for all ticks at once.
        to_new = (1 - z) * (1 - new * new)
        to_reset = to_new * recalled * r * (1 - r)
        to_update = (hs[:-1] - new) * z * (1 - z)
        to_seen = torch.stack((to_reset, to_update, to_new), 2)
        to_held = torch.stack((to_reset, to_update, to_new * r), 2)
        inside = closed[1:] & (y[:-1].abs() < 1.0)
        grad_y = grad_y.clone()
        grad_h = (grad_y.view(-1, len(output)) @ output).view(ticks, batch, size) + grad_states
        grad_held = x.new_empty(ticks, batch, 3, size)
        for k in range(ticks - 1, -1, -1):
            torch.mul(grad_h[k][:, None], to_held[k], out=grad_held[k])
            if k == 0:
                break
            before = grad_h[k - 1]
            before.addcmul_(grad_h[k], z[k]).addmm_(grad_held[k].view(batch, -1), by_h)
            if ctx.loops[k]:
                back = ((grad_h[k][:, None] * to_seen[k]).view(batch, -1) @ by_x).mul_(inside[k - 1])
                grad_y[k - 1].add_(back)
                before.addmm_(back, output)
        flat_seen = (grad_h[:, :, None] * to_seen).view(ticks * batch, -1)
        flat_held, flat_y = grad_held.view(ticks * batch, -1), grad_y.view(ticks * batch, -1)
        return (
            None,
            None,
            None,
            flat_seen.t() @ x.view(-1, inputs),
            flat_seen.sum(0),
            flat_held.t() @ hs[:-1].reshape(-1, size),
            flat_held.sum(0),
            flat_y.t() @ hs[1:].reshape(-1, size),
            flat_y.sum(0),
        )
