"""Muon: orthogonalised momentum for the weights of convolutions (Jordan et al. 2024)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import Parameter

# Of x → ax + bx³ + cx⁵, five times of which bring singular values from [0.01, 1] to [0.68, 1.14] (Jordan et al.).
# To be nearer to 1 gains nothing.
A, B, C = 3.4445, -4.7750, 2.0315
ITERATIONS = 5
# Norm of a momentum that still counts as one: a layer that nothing comes through any more (its ReLUs are zero
# everywhere) would be moved by what is left of it, in steps of full length.
LEAST = 1e-7


class Muon(torch.optim.Optimizer):
    """Gradient descent whose step is, of each parameter as the matrix of its first axis × the others, the orthogonal
    matrix nearest to its momentum: every direction learns equally fast, not the steepest ones first.

        m ← μ m + g,    w ← w - lr · √max(rows, columns) · orthogonal(g + μ m)

    The factor gives the entries a step of lr in the quadratic mean, which is about Adam's. For parameters of two axes
    and more; Adam is for the others.
    """

    def __init__(self, parameters: Iterable[Parameter], lr: float, momentum: float = 0.95) -> None:
        super().__init__(parameters, {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self) -> None:
        """One step on the gradients as they are; what has none stays."""
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state["momentum"] = torch.zeros_like(p)
                state["momentum"].mul_(group["momentum"]).add_(p.grad)
                update = orthogonal(p.grad.add(state["momentum"], alpha=group["momentum"]).flatten(1))
                p.sub_(update.view(p.shape), alpha=group["lr"] * math.sqrt(max(update.shape)))


def orthogonal(matrix: Tensor) -> Tensor:
    """About U Vᵀ of the singular value decomposition U S Vᵀ, by products of matrices alone (Newton-Schulz): singular
    values come to lie in [0.68, 1.14], but for those below a hundredth of the matrix's norm. All of it fades out where
    that norm comes down to `LEAST`."""
    wide = matrix.shape[0] <= matrix.shape[1]
    norm = matrix.norm()
    x = (matrix if wide else matrix.T) / norm.clamp_min(1e-5 * LEAST)  # squares of still less underflow
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = A * x + (B * square + C * square @ square) @ x
    return (x if wide else x.T).contiguous() * (norm / (norm + LEAST))
