"""Where something else passed that no test of surfaces tells apart: an arm before a body, a fork before a wheel."""

from __future__ import annotations

import torch
from torch import Tensor

from .alike import alike
from .fetch import fetch


def passed(
    uncovered: Tensor,  # [B, 1, H, W] bool (`splat.history_motion`)
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the frame
    before: tuple[Tensor, Tensor],  # the same of the frame that motion leads to
    motion: Tensor,  # [B, 2, H, W] traditional, in pixels
) -> Tensor:  # [B, 1, H, W] bool
    """Uncovered pixels whose motion leads to what is `alike`: that had covered them. Paths over recent frames
    (`ops.recall`) must end there. On a CPU these pixels alone are looked at."""
    if uncovered.device.type != "cpu":
        return uncovered & alike(surface, (fetch(before[0], motion), fetch(before[1], motion)))
    b, _, y, x = places = uncovered.nonzero(as_tuple=True)
    if not len(b):
        return uncovered
    H, W = motion.shape[2:]  # on the screen, as they are uncovered
    u, v = ((motion[b, c, y, x] + p + 0.5).long().clamp(0, n - 1) for c, p, n in ((0, x, W), (1, y, H)))
    here, there = ([z[b, :, i, j, None, None] for z in layers] for layers, i, j in ((surface, y, x), (before, v, u)))
    found = torch.zeros_like(uncovered)
    found[places] = alike(here, there).flatten()
    return found
