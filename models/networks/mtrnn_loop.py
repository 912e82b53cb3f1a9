"""The MTRNN's training loop over ticks, with its backward pass written out.

Its layers are so small that autograd over a dozen operations a tick costs more than their arithmetic: this loop takes
a third of the time. Same numbers as MTRNN.step called in a loop: a test compares them.
"""

from typing import Any

import torch
from torch import Tensor


class MtrnnLoop(torch.autograd.Function):
    """x (T, B, n), closed (T, B, 1), u (B, S), 1/tau (S,) and the MTRNN's parameters to y (T, B, m), states (T, B, S).

    Both layers at once: u <- (1 - 1/tau) u + (1/tau)(W [x, tanh u] + b), with W = 0 from x to the slow layer, which
    comes last. Parameters, each with its bias: to_fast (F, n + S), to_slow (S - F, S), output (m, F). No gradients to
    x, u and 1/tau: they are data.
    """

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, closed: Tensor, u: Tensor, rate: Tensor, *parameters: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Ticks where any sequence is closed take its own clipped prediction as that sequence's input."""
        to_fast, fast_bias, to_slow, slow_bias, output, output_bias = parameters
        ticks, batch, inputs = x.shape
        fast, size = len(to_fast), u.shape[1]
        by_x = rate[:fast, None] * to_fast[:, :inputs]
        by_h = rate[:, None] * torch.cat((to_fast[:, inputs:], to_slow))
        bias = rate * torch.cat((fast_bias, slow_bias))
        from_x, from_h, to_y = by_x.t().contiguous(), by_h.t().contiguous(), output.t()
        loops = closed.flatten(1).any(1).tolist()
        loops[0] = False  # there is no prediction yet
        x = x.clone()
        pushed = bias.repeat(ticks, batch, 1)
        pushed[..., :fast] += (x.view(-1, inputs) @ from_x).view(ticks, batch, fast)
        y = x.new_empty(ticks, batch, len(output))
        us, hs = x.new_empty(2, ticks + 1, batch, size)
        us[0] = u
        torch.tanh(u, out=hs[0])
        keep = 1.0 - rate
        # Lists of views: taking one out of a tensor at each tick would cost as much as the arithmetic on it.
        by_tick = (x, closed, y, us, hs, hs[..., :fast], pushed, pushed[..., :fast])
        x_k, closed_k, y_k, u_k, h_k, fast_h_k, pushed_k, fast_pushed_k = (a.unbind(0) for a in by_tick)
        for k in range(ticks):
            if loops[k]:
                torch.addmm(output_bias, fast_h_k[k], to_y, out=y_k[k - 1])
                torch.where(closed_k[k], y_k[k - 1].clamp(-1.0, 1.0), x_k[k], out=x_k[k])
                torch.addmm(bias[:fast], x_k[k], from_x, out=fast_pushed_k[k])
            torch.addcmul(pushed_k[k], keep, u_k[k], out=u_k[k + 1]).addmm_(h_k[k], from_h)
            torch.tanh(u_k[k + 1], out=h_k[k + 1])
        y.copy_((hs[1:, :, :fast].reshape(-1, fast) @ to_y + output_bias).view_as(y))
        ctx.save_for_backward(x, closed, hs, y, rate, by_x, by_h, output)
        ctx.loops = loops
        return y, us[1:].clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_y: Tensor, grad_states: Tensor) -> tuple[Tensor | None, ...]:
        """Backpropagation through time."""
        x, closed, hs, y, rate, by_x, by_h, output = ctx.saved_tensors
        ticks, batch, inputs = x.shape
        fast, size = len(by_x), len(by_h)
        slope = 1.0 - hs[1:].square()
        inside = closed[1:] & (y[:-1].abs() < 1.0)
        keep = 1.0 - rate
        grad_y = grad_y.clone()
        grad_u = grad_states.clone()
        grad_u[..., :fast] += (grad_y.view(-1, len(output)) @ output).view(ticks, batch, fast) * slope[..., :fast]
        by_tick = (inside, grad_y, grad_u, grad_u[..., :fast], slope)
        inside_k, grad_y_k, grad_u_k, fast_grad_k, slope_k = (a.unbind(0) for a in by_tick)
        for k in range(ticks - 1, 0, -1):
            back_h = grad_u_k[k] @ by_h
            if ctx.loops[k]:
                back = (fast_grad_k[k] @ by_x).mul_(inside_k[k - 1])
                grad_y_k[k - 1].add_(back)
                back_h[:, :fast].addmm_(back, output)
            grad_u_k[k - 1].addcmul_(keep, grad_u_k[k]).addcmul_(back_h, slope_k[k - 1])
        flat, flat_y = (grad_u * rate).view(ticks * batch, -1), grad_y.view(ticks * batch, -1)
        by_hidden, by_bias = flat.t() @ hs[:-1].reshape(-1, size), flat.sum(0)
        by_fast = torch.cat((flat[:, :fast].t() @ x.view(-1, inputs), by_hidden[:fast]), 1)
        by_output = flat_y.t() @ hs[1:, :, :fast].reshape(-1, fast)
        gradients = (by_fast, by_bias[:fast], by_hidden[fast:], by_bias[fast:], by_output, flat_y.sum(0))
        return (None, None, None, None, *gradients)
