"""Muon: orthogonalised momentum for the weights of convolutions (Jordan et al. 2024)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import Parameter

# Coefficients of x → ax + bx³ + cx⁵. Five iterations bring singular values from [0.01, 1] to [0.68, 1.14] (Jordan et
# al.); closer to 1 gains nothing.
A, B, C = 3.4445, -4.7750, 2.0315
ITERATIONS = 5
MOMENTUM = 0.95  # μ
# Norm of the momentum below which steps fade out. Otherwise a dead layer (its ReLUs are zero everywhere) would take
# steps of full length from the remains of its momentum.
MIN_MOMENTUM = 1e-7


class Muon(torch.optim.Optimizer):
    """Gradient descent by orthogonalised momentum: each parameter counts as a matrix (first axis × the others), and its
    step is the orthogonal matrix closest to its momentum. All directions learn equally fast.

        m ← μ m + g,    w ← w - lr · √max(rows, columns) · orthogonal(g + μ m)

    With this factor the entries move by lr in the quadratic mean, about as with Adam. For parameters with two axes and
    more; use Adam for the others.
    """

    def __init__(self, parameters: Iterable[Parameter], lr: float) -> None:
        super().__init__(parameters, {"lr": lr})

    @torch.no_grad()
    def step(self) -> None:
        """One step with the present gradients; parameters without one stay."""
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state["momentum"] = torch.zeros_like(p)
                state["momentum"].mul_(MOMENTUM).add_(p.grad)
                update = orthogonal(p.grad.add(state["momentum"], alpha=MOMENTUM).flatten(1))
                p.sub_(update.view(p.shape), alpha=group["lr"] * math.sqrt(max(update.shape)))


def orthogonal(matrix: Tensor) -> Tensor:
    """Approximate U Vᵀ of the singular value decomposition U S Vᵀ by matrix products alone (Newton-Schulz). Singular
    values end in [0.68, 1.14], except those below a hundredth of the matrix's norm. The result fades to 0 as that norm
    falls to `MIN_MOMENTUM`."""
    wide = matrix.shape[0] <= matrix.shape[1]
    norm = matrix.norm()
    x = (matrix if wide else matrix.T) / norm.clamp_min(1e-5 * MIN_MOMENTUM)  # squares of smaller values underflow
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = A * x + (B * square + C * square @ square) @ x
    return (x if wide else x.T).contiguous() * (norm / (norm + MIN_MOMENTUM))
