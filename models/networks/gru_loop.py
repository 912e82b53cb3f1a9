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
        # Lists of views: taking one out of a tensor at each tick would cost as much as the arithmetic on it.
        by_tick = (x, closed, y, hs, seen, seen[..., : 2 * size], seen[..., 2 * size :], gates, recalled, new)
        x_k, closed_k, y_k, h_k, seen_k, seen_gates_k, seen_new_k, gates_k, recalled_k, new_k = (
            a.unbind(0) for a in by_tick
        )
        r_k, z_k = (a.unbind(0) for a in gates.split(size, 2))
        held = x.new_empty(batch, 3 * size)
        held_gates, held_new = held.split((2 * size, size), 1)
        for k in range(ticks):
            if loops[k]:
                torch.addmm(output_bias, h_k[k], to_y, out=y_k[k - 1])
                torch.where(closed_k[k], y_k[k - 1].clamp(-1.0, 1.0), x_k[k], out=x_k[k])
                torch.addmm(by_x_bias, x_k[k], from_x, out=seen_k[k])
            torch.addmm(by_h_bias, h_k[k], from_h, out=held)
            torch.add(seen_gates_k[k], held_gates, out=gates_k[k]).sigmoid_()
            recalled_k[k].copy_(held_new)
            torch.addcmul(seen_new_k[k], r_k[k], held_new, out=new_k[k]).tanh_()
            torch.lerp(new_k[k], h_k[k], z_k[k], out=h_k[k + 1])
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
        by_tick = (inside, grad_y, grad_h, z, to_seen, to_held, grad_held, grad_held.flatten(2))
        inside_k, grad_y_k, grad_h_k, z_k, to_seen_k, to_held_k, grad_held_k, flat_held_k = (
            a.unbind(0) for a in by_tick
        )
        for k in range(ticks - 1, -1, -1):
            now = grad_h_k[k][:, None]
            torch.mul(now, to_held_k[k], out=grad_held_k[k])
            if k == 0:
                break
            before = grad_h_k[k - 1]
            before.addcmul_(grad_h_k[k], z_k[k]).addmm_(flat_held_k[k], by_h)
            if ctx.loops[k]:
                back = ((now * to_seen_k[k]).view(batch, -1) @ by_x).mul_(inside_k[k - 1])
                grad_y_k[k - 1].add_(back)
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
