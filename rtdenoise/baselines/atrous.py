"""The spatial half of SVGF: edge-stopping weights, the à-trous wavelet filter and the spatial variance estimate.

Schied et al., *Spatiotemporal Variance-Guided Filtering*, HPG 2017 ("SVGF"); the wavelet after Dammertz
et al. 2010.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import luminance

SPLINE = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)  # B3, h of the à-trous filter
MISS = 1.0  # the kind of a pixel where nothing was hit
TINY = 1e-20  # smaller than every difference that matters: turns 0 / 0 into weight 1


@dataclass(frozen=True)
class Surface:
    """The geometry that the edge-stopping functions compare."""

    depth: Tensor  # [B, 1, H, W], 0: nothing hit
    normal: Tensor  # [B, 3, H, W]
    kind: Tensor  # [B, 1, H, W] `MISS`, or a number > 0 for each kind of surface; kinds are never mixed
    slope: Tensor  # [B, 2, H, W] change of depth a pixel along x and y
    sigma_z: float
    sigma_n: float

    @classmethod
    def of(cls, depth: Tensor, normal: Tensor, kind: Tensor, sigma_z: float, sigma_n: float) -> Surface:
        """The slope is the smaller of forward and backward difference, so that a silhouette does not count as slope."""
        return cls(depth, normal, kind, torch.cat([_slope(depth, 3), _slope(depth, 2)], dim=1), sigma_z, sigma_n)

    def weights(self, radius: int, spacing: int) -> Iterator[tuple[int, int, Tensor]]:
        """(dy, dx, w) of every tap, w `[B, 1, H, W]` = w_z · w_n of SVGF between p and q = p + d:

            w_z = exp(-|z(p) - z(q)| / (σ_z · |∇z(p) · d| + 10⁻³ z(p)))        w_n = max(0, n(p) · n(q))^σ_n

        d is `spacing` · (dx, dy) pixels. w = 1 between two misses and at the pixel itself, 0 between different kinds
        and outside the image. The term 10⁻³ z(p) allows for rounding and curvature within one surface.
        """
        miss = self.kind == MISS
        guides = torch.cat([self.depth, self.normal, self.kind], dim=1)
        for dy, dx, q in taps(guides, radius, spacing):
            if dy == dx == 0:
                yield dy, dx, torch.ones_like(self.depth)
                continue
            depth, normal, kind = q[:, :1], q[:, 1:4], q[:, 4:]
            step = (spacing * (dx * self.slope[:, :1] + dy * self.slope[:, 1:])).abs()
            near = (-(self.depth - depth).abs() / (self.sigma_z * step + 1e-3 * self.depth + TINY)).exp()
            aligned = (self.normal * normal).sum(1, keepdim=True).clamp(0, 1) ** self.sigma_n
            yield dy, dx, (kind == self.kind) * torch.where(miss, 1.0, near * aligned)


def atrous(
    image: Tensor,  # [B, 3, H, W]
    variance: Tensor,  # [B, 1, H, W] of its luminance
    surface: Surface,
    spacing: int,  # pixels between taps: 1, 2, 4, 8, 16
    sigma_l: float,
) -> tuple[Tensor, Tensor]:  # the same, filtered
    """One level of the edge-stopping wavelet (SVGF), 5×5 taps:

        w(p,q)    = h(q - p) · w_z · w_n · exp(-|l(p) - l(q)| / (σ_l · √(G Var(p))))
        image'    = Σ_q w · image(q) / Σ_q w
        Var'      = Σ_q w² · Var(q) / (Σ_q w)²

    with G a 3×3 Gaussian. A constant image does not change.
    """
    light = luminance(image)
    tolerance = sigma_l * gaussian(variance).sqrt() + TINY
    signal = torch.cat([image, light, variance], dim=1)
    total, filtered = torch.zeros_like(variance), torch.zeros_like(image)
    spread = torch.zeros_like(variance)
    for (dy, dx, geometry), (_, _, q) in zip(surface.weights(2, spacing), taps(signal, 2, spacing), strict=True):
        like = (-(light - q[:, 3:4]).abs() / tolerance).exp()
        w = SPLINE[dy + 2] * SPLINE[dx + 2] * geometry * like
        total += w
        filtered += w * q[:, :3]
        spread += w.square() * q[:, 4:]
    return filtered / total, spread / total.square()


def spatial_variance(
    moments: Tensor,  # [B, 2, H, W] of luminance: mean, mean square
    surface: Surface,
) -> Tensor:  # [B, 1, H, W]
    """Variance of one sample from a 7×7 neighbourhood on the same surface (SVGF, where history is too short)."""
    total, mean = torch.zeros_like(surface.depth), torch.zeros_like(moments)
    for (_, _, w), (_, _, q) in zip(surface.weights(3, 1), taps(moments, 3, 1), strict=True):
        total += w
        mean += w * q
    first, second = (mean / total).split(1, dim=1)
    return (second - first.square()).clamp(min=0)


def gaussian(image: Tensor) -> Tensor:
    """3×3 Gaussian (¼, ½, ¼ along each axis), normalised inside the image."""
    _, C, H, W = image.shape
    row = image.new_tensor([0.25, 0.5, 0.25])
    kernel = (row[:, None] * row).expand(C, 1, 3, 3)
    weight = F.conv2d(image.new_ones(1, 1, H, W), kernel[:1], padding=1)
    return F.conv2d(image, kernel, padding=1, groups=C) / weight


def taps(image: Tensor, radius: int, spacing: int) -> Iterator[tuple[int, int, Tensor]]:
    """(dy, dx, image(p + spacing · (dx, dy))) for dy, dx in -radius..radius, views `[B, C, H, W]`; 0 outside."""
    _, _, H, W = image.shape
    border = radius * spacing
    padded = F.pad(image, [border] * 4)
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            top, left = border + dy * spacing, border + dx * spacing
            yield dy, dx, padded[..., top : top + H, left : left + W]


def _slope(depth: Tensor, axis: int) -> Tensor:
    """The smaller in magnitude of forward and backward difference along `axis`; at the border, the only one."""
    if depth.shape[axis] == 1:
        return torch.zeros_like(depth)
    difference = depth.diff(dim=axis)
    n = difference.shape[axis]
    forward = torch.cat([difference, difference.narrow(axis, n - 1, 1)], dim=axis)
    backward = torch.cat([difference.narrow(axis, 0, 1), difference], dim=axis)
    return torch.where(forward.abs() < backward.abs(), forward, backward)
