"""The loop over the ticks of a batch of sequences, with its backward pass written out.

What does not wait for the tick before is one product for all ticks, and autograd, which would record a dozen small
operations a tick, is left out. Same numbers as `step` called in a loop: a test compares them.
"""

from typing import Any, Protocol

import torch
from torch import Tensor


class Cell(Protocol):
    """What U units do at a tick, each by itself: sums a (B, n U) and memory m (B, U) give m and the hidden h (B, U).

    The hidden goes into the next tick's sums and into the output, the memory only to its own unit at the next tick.
    """

    def advance(self, a: Tensor, blocks: tuple[Tensor, ...], m: Tensor) -> tuple[Tensor, Tensor]:
        """m_k and h_k from a_k, its n blocks (B, U), which are views of it, and m_{k-1}; `a` may be written over."""
        ...

    def slopes(self, a: Tensor, before: Tensor, m: Tensor, h: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Derivatives at all ticks, from a (T, B, n U) as `advance` left it, and m_{k-1}, m_k, h_k (T, B, U).

        Returns dh_k/dm_k and dm_k/dm_{k-1}, (T, B, U) or what broadcasts to it; then, for the first p of the n blocks
        of sums, dh_k/da_k past m_k (T, B, p, U), and for the others dm_k/da_k (T, B, n - p, U).
        """
        ...


class Loop(torch.autograd.Function):
    """Runs a Cell from h and m (B, U) over x (T, B, i): y (T, B, o), h and m (T, B, U).

    The sums are bias + x_k from_x in the first columns, + h_{k-1} from_h in the last ones; y_k = h_k to_y + y_bias.
    Where `closed` (T, B, 1) is True, but at the first tick, the own clipped prediction takes the input's place. No
    gradients to x and to the first h and m: they are data.
    """

    @staticmethod
    def forward(
        ctx: Any, cell: Cell, x: Tensor, closed: Tensor, h: Tensor, m: Tensor, *weights: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """`weights`: from_x (i, <= n U), from_h (U, <= n U), bias (n U,), to_y (U, o), y_bias (o,)."""
        from_x, from_h, bias, to_y, y_bias = (weight.contiguous() for weight in weights)
        to_x, to_h = from_x.shape[1], len(bias) - from_h.shape[1]
        loops = closed.flatten(1).any(1).tolist()
        x, a = x.clone(), bias.repeat(*x.shape[:2], 1)
        a[..., :to_x] += x @ from_x
        # Lists of views: taking one out of a tensor at each tick would cost as much as the arithmetic on it.
        by_tick = (x, closed, a, a[..., :to_x], a[..., to_h:])
        x_k, closed_k, a_k, by_x_k, by_h_k = (whole.unbind(0) for whole in by_tick)
        blocks = list(zip(*(block.unbind(0) for block in a.unflatten(2, (-1, m.shape[1])).unbind(2)), strict=True))
        hs, ms = [h], [m]
        for k in range(len(x)):
            if k and loops[k]:
                own = torch.addmm(y_bias, h, to_y).clamp_(-1.0, 1.0)
                torch.where(closed_k[k], own, x_k[k], out=x_k[k])
                torch.addmm(bias[:to_x], x_k[k], from_x, out=by_x_k[k])
            by_h_k[k].addmm_(h, from_h)
            m, h = cell.advance(a_k[k], blocks[k], m)
            hs.append(h)
            ms.append(m)
        all_h, all_m = torch.stack(hs), torch.stack(ms)
        y = all_h[1:] @ to_y + y_bias
        ctx.save_for_backward(x, closed, a, all_h, all_m, y, from_x, from_h, to_y)
        ctx.cell, ctx.loops = cell, loops
        return y, all_h[1:], all_m[1:]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_y: Tensor, grad_h: Tensor, grad_m: Tensor) -> tuple[Tensor | None, ...]:
        """Backpropagation through time."""
        x, closed, a, hs, ms, y, from_x, from_h, to_y = ctx.saved_tensors
        ticks, batch, units = grad_h.shape
        h_by_m, m_by_m, h_by_a, m_by_a = ctx.cell.slopes(a, ms[:-1], ms[1:], hs[1:])
        inside = closed[1:] & (y[:-1].abs() < 1.0)
        to_x, to_h, past = from_x.shape[1], a.shape[2] - from_h.shape[1], h_by_a.shape[2]
        grad_h, grad_m, grad_y = grad_h + grad_y @ to_y.t(), grad_m.clone(), grad_y.clone()
        grad_a, (back_x, back_h, back_y) = torch.empty_like(a), (weight.t() for weight in (from_x, from_h, to_y))
        blocks = grad_a.view(ticks, batch, -1, units)
        by_tick = (inside, grad_y, grad_h, grad_h[:, :, None], grad_m, grad_a[..., :to_x], grad_a[..., to_h:])
        inside_k, grad_y_k, grad_h_k, wide_h_k, grad_m_k, to_x_k, to_h_k = (whole.unbind(0) for whole in by_tick)
        slopes = (h_by_m.expand_as(grad_m), m_by_m.expand_as(grad_m), h_by_a, m_by_a)
        h_by_m_k, m_by_m_k, h_by_a_k, m_by_a_k = (slope.unbind(0) for slope in slopes)
        by_h_k, by_m_k = blocks[:, :, :past].unbind(0), blocks[:, :, past:].unbind(0)
        for k in range(ticks - 1, -1, -1):
            through_m = grad_m_k[k].addcmul_(grad_h_k[k], h_by_m_k[k])
            torch.mul(through_m.unsqueeze(1), m_by_a_k[k], out=by_m_k[k])
            if past:
                torch.mul(wide_h_k[k], h_by_a_k[k], out=by_h_k[k])
            if not k:
                break
            grad_m_k[k - 1].addcmul_(through_m, m_by_m_k[k])
            grad_h_k[k - 1].addmm_(to_h_k[k], back_h)
            if ctx.loops[k]:
                back = (to_x_k[k] @ back_x).mul_(inside_k[k - 1])
                grad_y_k[k - 1].add_(back)
                grad_h_k[k - 1].addmm_(back, back_y)
        x, hs, grad_a, grad_y = (whole.flatten(0, 1) for whole in (x, hs, grad_a, grad_y))
        by_x, by_h = x.t() @ grad_a[:, :to_x], hs[:-batch].t() @ grad_a[:, to_h:]
        return (*[None] * 5, by_x, by_h, grad_a.sum(0), hs[batch:].t() @ grad_y, grad_y.sum(0))
