"""The training loss: spatial, temporal and motion-occlusion terms (the paper, eq. 5 and 6)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress
from ..frame import Frame

LEAST_SQUARE = 1e-5  # of z's error: a frame that is nearly right weighs no more than this
MAX_DIFFERENCE = 2.0  # of a reference from z, relative


@dataclass(frozen=True)
class Loss:
    """The three terms of each image of a batch, `[B]`."""

    spatial: Tensor
    temporal: Tensor
    occlusion: Tensor

    @property
    def total(self) -> Tensor:
        return self.spatial + self.temporal + self.occlusion


def temporal_kpn_loss(
    image: Tensor,  # [B, 3, H, W] denoised radiance of frame i
    reference: Tensor,  # [B, 3, H, W]
    previous: tuple[Tensor, Tensor] | None,  # (image, reference) of frame i - 1
    occlusion: Tensor | None,  # [B, 1, H, W] Σ w_k M_{i-k} (`motion.occlusion_weights`); None: without L_occ
    scale: Tensor | float = 1.0,  # [B, 1, 1, 1] exposure, the same for both frames
    huber: float = 0.0,  # error up to which a difference counts as its square / (2 · huber)
) -> Loss:
    """L = L1(I, R) + L1(I_i - I_{i-1}, R_i - R_{i-1}) + L1(I ⊙ Σ w_k M_k, R ⊙ Σ w_k M_k).

    The domain is `color.compress` of the exposed radiance: in linear radiance a few fireflies would be the whole loss.
    With `huber` the distances are Huber's: against noisy references L1 aims at the median, which is too dark, squares
    aim at the mean. The weights of eq. 5 apply after the compression, so that they mean the same in dark and in bright
    places.
    """

    def distance(a: Tensor, b: Tensor) -> Tensor:
        return F.smooth_l1_loss(a, b, beta=huber, reduction="none").mean((1, 2, 3))

    image, reference = compress(image * scale), compress(reference * scale)
    spatial = distance(image, reference)
    temporal = occluded = torch.zeros_like(spatial)
    if previous is not None:
        before, reference_before = (compress(x * scale) for x in previous)
        temporal = distance(image - before, reference - reference_before)
    if occlusion is not None:
        occluded = distance(image * occlusion, reference * occlusion)
    return Loss(spatial, temporal, occluded)


def frame_loss(
    image: Tensor,
    frame: Frame,
    previous: tuple[Tensor, Tensor] | None,
    occlusion: Tensor | None,
    scale: Tensor | float,
    huber: float,
) -> Loss:
    """As `Denoiser.loss`: `temporal_kpn_loss` against the frame's reference."""
    return temporal_kpn_loss(image, frame.reference, previous, occlusion, scale, huber)


def mltd_loss(
    image: Tensor,
    frame: Frame,
    previous: tuple[Tensor, Tensor] | None,
    occlusion: Tensor | None,
    scale: Tensor | float,
    huber: float,
) -> Loss:
    """As `Denoiser.loss`, without a term for occlusion: SMAPE(I, R) + ½ SMAPE(I_i - I_{i-1}, R_i - R_{i-1}) on exposed
    linear radiance (Chen et al. 2024, eq. 10 and 11)."""
    spatial = smape(image, frame.reference, scale)
    temporal = torch.zeros_like(spatial)
    if previous is not None:
        temporal = 0.5 * smape(image - previous[0], frame.reference - previous[1], scale)
    return Loss(spatial, temporal, torch.zeros_like(spatial))


def smape(image: Tensor, reference: Tensor, scale: Tensor | float = 1.0) -> Tensor:
    """Symmetric mean absolute percentage error of each image, `[B, 3, H, W] -> [B]` in [0, 1).

    |R - I|₁ / (|R|₁ + |I|₁ + 0.01), the norms over the channels of a pixel, on linear radiance times `scale`
    `[B, 1, 1, 1]`: the 0.01 means something only at a known exposure (Vogels et al. 2018; Zhou et al.).
    """
    image, reference = image * scale, reference * scale
    error = (image - reference).abs().sum(1)
    return (error / (image.abs().sum(1) + reference.abs().sum(1) + 0.01)).mean((1, 2))


def smape_ratio(image: Tensor, estimate: Tensor, reference: Tensor, scale: Tensor | float = 1.0) -> Tensor:
    """`smape` of the image divided by that of `estimate`, mean over the batch: frames of many samples, whose errors are
    small, count as much as frames of few."""
    return (smape(image, reference, scale) / smape(estimate, reference, scale).clamp(min=0.01)).mean()


def square_ratio(image: Tensor, estimate: Tensor, reference: Tensor, scale: Tensor | float = 1.0) -> Tensor:
    """As `smape_ratio`, of mean squared differences from z relative to 1 / scale + z.

    Linear in the reference, so that its noise moves no optimum: a logarithm of noisy references is too dark. Only
    differences beyond `MAX_DIFFERENCE`, which are fireflies, are cut off.
    """
    relative = scale / (1 + scale * estimate.clamp(min=0))
    change, wanted = ((x - estimate) * relative for x in (image, reference))
    wanted = wanted.clamp(-MAX_DIFFERENCE, MAX_DIFFERENCE)
    error, before = (x.square().mean((1, 2, 3)) for x in (change - wanted, wanted))
    return (error / before.clamp(min=LEAST_SQUARE)).mean()
