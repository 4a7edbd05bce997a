"""SVGF: spatiotemporal variance-guided filtering, from its description in Schied et al., HPG 2017. Read `Svgf.step`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor

from ..color import luminance
from ..frame import Frame, expect_history
from ..motion import dual_motion, occlusion_mask, on_screen, same_surface
from ..ops import blend, fetch
from ..sanitise import admit
from .atrous import MISS, Surface, atrous, spatial_variance
from .clamp import clamp_to_neighbourhood

LEVELS = 5  # of the wavelet
MAX_LENGTH = 32  # frames of history that are counted
MIN_TEMPORAL_LENGTH = 4  # frames of history for an estimate of variance over time (SVGF)
MIN_WEIGHT = 1e-3  # sum of bilinear weights below which a pixel has no history
MIN_TEXTURED_ALBEDO = 0.01  # darker surfaces are not demodulated
BARE, TEXTURED = 2.0, 3.0  # kinds of surfaces beside MISS: filtered as radiance, filtered as irradiance
MAX_IRRADIANCE = 1e18  # its square is still a float32


@dataclass(frozen=True)
class SvgfState:
    """The state that one step of SVGF passes to the next."""

    irradiance: Tensor  # [B, 3, H, W] demodulated, after the first level of the filter
    moments: Tensor  # [B, 2, H, W] running mean of luminance and of its square
    length: Tensor  # [B, 1, H, W] frames in the history, 1 to MAX_LENGTH
    spread: Tensor  # [B, 1, H, W] Σ w² over the weights of these frames: 1 / n for a plain mean
    depth: Tensor  # [B, 1, H, W]
    normal: Tensor  # [B, 3, H, W]
    kind: Tensor  # [B, 1, H, W] MISS, BARE or TEXTURED
    motion_next: Tensor | None  # [B, 2, H, W]


@dataclass(frozen=True)
class Svgf:
    """The filter and its parameters; bench/calibration/tune_baselines.py chose the defaults."""

    alpha: float = 0.2  # minimum weight of the current frame
    sigma_z: float = 3.0  # tolerance of depth, in slopes of the surface
    sigma_n: float = 16.0  # exponent of the cosine between normals
    sigma_l: float = 8.0  # tolerance of luminance, in standard deviations
    depth_tolerance: float = 0.1  # of reprojection, relative
    normal_tolerance: float = 0.5  # of reprojection, minimum cosine
    clamp: float | None = None  # k: history clamped to mean ± k·σ of 5×5 noisy pixels; None: not clamped
    motion: str = "traditional"  # or 'dual': the motion that fetches history

    def step(self, frame: Frame, history: SvgfState | None = None) -> tuple[Tensor, SvgfState]:
        """As `TemporalKPN.step`.

        Raises InputError where albedo, normal, depth or (with history) motion is missing, or history is of another
        size.
        """
        expect_history(history, SvgfState)
        frame = admit(frame, history and history.irradiance)
        kind = kind_of(frame)
        albedo = torch.where(kind == TEXTURED, frame.albedo.clamp(min=MIN_TEXTURED_ALBEDO), 1.0)
        irradiance = (frame.radiance / albedo).clamp(max=MAX_IRRADIANCE)
        surface = Surface.of(frame.depth, frame.normal, kind, self.sigma_z, self.sigma_n)

        # Accumulate irradiance and the moments of its luminance over time.
        light = luminance(irradiance)
        moments, length = torch.cat([light, light.square()], dim=1), torch.ones_like(light)
        spread = torch.ones_like(light)
        if history is not None:
            old = self.reproject(frame, history, irradiance, kind)
            length = (old.length + 1).clamp(max=MAX_LENGTH)
            weight = (1 / length).clamp(min=self.alpha)
            irradiance = blend(irradiance, old.irradiance, weight)
            moments = blend(moments, old.moments, weight)
            spread = weight.square() + (1 - weight).square() * old.spread

        # Filter in space, guided by the variance; the first level is the next frame's history.
        variance = estimate_variance(moments, length, spread, surface)
        first, variance = atrous(irradiance, variance, surface, 1, self.sigma_l)
        filtered = first
        for level in range(1, LEVELS):
            filtered, variance = atrous(filtered, variance, surface, 2**level, self.sigma_l)
        state = SvgfState(first, moments, length, spread, frame.depth, frame.normal, kind, frame.motion_next)
        return filtered * albedo, state

    def reproject(self, frame: Frame, history: SvgfState, irradiance: Tensor, kind: Tensor) -> SvgfState:
        """The history of each pixel's surface; its length is 0 where there is none.

        A bilinear tap counts if it is on the screen, of the same kind and on the same surface (`motion.same_surface`).
        Where none of the four counts, the mean of the valid pixels among the 3×3 around the target is taken.
        """
        motion = self.reprojection(frame, history)
        stored = torch.cat([history.irradiance, history.moments, history.length, history.spread], dim=1)
        start = motion.floor()  # to a whole pixel, because p is one
        fx, fy = (motion - start).split(1, dim=1)
        bilinear = {(0, 0): (1 - fx) * (1 - fy), (1, 0): fx * (1 - fy), (0, 1): (1 - fx) * fy, (1, 1): fx * fy}
        total, found = self._gather(frame, kind, history, stored, start, bilinear)
        box = dict.fromkeys(product((-1, 0, 1), repeat=2), torch.ones_like(total))
        box_total, box_found = self._gather(frame, kind, history, stored, (motion + 0.5).floor(), box)
        # Dividing by a tiny weight would amplify rounding errors.
        lost = total < MIN_WEIGHT
        total, found = torch.where(lost, box_total, total), torch.where(lost, box_found, found)
        valid = total >= MIN_WEIGHT
        old = torch.where(valid, found / total.clamp(min=MIN_WEIGHT), 0.0)
        color = old[:, :3]
        if self.clamp is not None:
            color = torch.where(valid, clamp_to_neighbourhood(color, irradiance, self.clamp), 0.0)
        return replace(history, irradiance=color, moments=old[:, 3:5], length=old[:, 5:6], spread=old[:, 6:])

    def reprojection(self, frame: Frame, history: SvgfState) -> Tensor:
        """The motion that fetches history, `[B, 2, H, W]`: for 'dual', dual motion inside uncovered regions."""
        if self.motion == "traditional" or history.motion_next is None:
            return frame.motion
        dual = dual_motion(frame.motion, history.motion_next)
        return torch.where(occlusion_mask(dual, frame.motion), dual, frame.motion)

    def _gather(
        self,
        frame: Frame,
        kind: Tensor,  # [B, 1, H, W]
        history: SvgfState,
        stored: Tensor,  # [B, C, H, W]
        start: Tensor,  # [B, 2, H, W] motion to a whole pixel
        weights: dict[tuple[int, int], Tensor],  # (dx, dy) from there: [B, 1, H, W]
    ) -> tuple[Tensor, Tensor]:  # [B, 1, H, W], [B, C, H, W]
        """Σ w and Σ w · stored over the taps that pass the tests."""
        total, found = torch.zeros_like(frame.depth), torch.zeros_like(stored)
        for offset, weight in weights.items():
            tap = start + start.new_tensor(offset).reshape(1, 2, 1, 1)
            same = same_surface(
                frame.depth, frame.normal, history.depth, history.normal, tap,
                self.depth_tolerance, self.normal_tolerance,
            )  # fmt: skip
            weight = weight * (same & on_screen(tap) & (fetch(history.kind, tap) == kind))
            total += weight
            found += weight * fetch(stored, tap)
        return total, found


def kind_of(frame: Frame) -> Tensor:
    """The kind of each pixel, `[B, 1, H, W]`: MISS, BARE where all of the albedo is below `MIN_TEXTURED_ALBEDO`, else
    TEXTURED.

    Only TEXTURED pixels are demodulated (radiance divided by albedo). Kinds keep radiance and irradiance from being
    averaged.
    """
    surface = torch.where(frame.albedo.amax(1, keepdim=True) < MIN_TEXTURED_ALBEDO, BARE, TEXTURED)
    return torch.where(frame.depth > 0, surface, MISS)


def estimate_variance(moments: Tensor, length: Tensor, spread: Tensor, surface: Surface) -> Tensor:
    """Variance of the luminance of a pixel's accumulated samples, `[B, 1, H, W]`.

    With running moments μ₁, μ₂ of weights w that sum to 1 and s = Σ w², independent samples of variance v have
    E[μ₂ - μ₁²] = (1 - s) v, and their weighted mean has variance s · v, which is v / n for a plain mean of n. So

        Var = s · (μ₂ - μ₁²) / (1 - s)        where n ≥ 4
        Var = s · v                           else, v from the neighbourhood (`spatial_variance`)

    SVGF prints μ₂ - μ₁² itself, which remains v for any length of history.
    """
    over_time = (moments[:, 1:] - moments[:, :1].square()).clamp(min=0) / (1 - spread).clamp(min=0.01)
    return spread * torch.where(length >= MIN_TEMPORAL_LENGTH, over_time, spatial_variance(moments, surface))
