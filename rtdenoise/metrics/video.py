"""Errors over time: flicker, ghosts, and the quality of a whole sequence to an observer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import torch
from torch import Tensor

from ..color import display
from ..errors import InputError
from ..motion import on_screen
from ..ops import fetch
from .image import decibels, decibels_of_estimate, displayed, exposed, masked_mean


def tpsnr(
    images: tuple[Tensor, Tensor],  # frames i - 1 and i, [1, 3, H, W] linear radiance
    references: tuple[Tensor, Tensor],
    scale: Tensor | float,  # exposure of all (`color.display_exposure`, one for a sequence)
    mask: Tensor | None = None,  # [1, 1, H, W] bool, of frame i
) -> float:
    """PSNR of temporal differences in dB, on the display transform D with peak 1:

        tPSNR = -10 · log₁₀ mean((ΔI - ΔR)²),    ΔI = D(I_i) - D(I_{i-1}),    ΔR = D(R_i) - D(R_{i-1})

    at the same pixel, without motion compensation: a constant error costs nothing, flicker does. NaN where the mask is
    empty.
    """
    return decibels(masked_mean(_apart(displayed(scale, *images, *references)).square(), mask))


def tmse_corrected(
    images: tuple[Tensor, Tensor],
    references: tuple[Tensor, Tensor],
    scale: Tensor | float,
    mask: Tensor | None = None,
    *,
    reference_halves: tuple[Tensor, Tensor],  # [1, 3, H, W] means of one half of the references' samples
) -> float:
    """The mean square of `tpsnr` minus what the references' noise adds to it, arguments as there: as
    `image.mse_corrected`, from the difference of both halves' changes,

        mean((ΔI - ΔR)²) - mean((ΔR₁ - ΔR₂)²) / 4

    The estimate is noisy and can be 0 or negative: average it over frames before taking a logarithm.
    """
    others = tuple(2 * whole - half for whole, half in zip(references, reference_halves, strict=True))
    difference = _apart(displayed(scale, *images, *references))
    noise = _apart(displayed(scale, *reference_halves, *others))
    return masked_mean(difference.square(), mask) - masked_mean(noise.square(), mask) / 4


def tpsnr_corrected(
    images: tuple[Tensor, Tensor],
    references: tuple[Tensor, Tensor],
    scale: Tensor | float,
    mask: Tensor | None = None,
    *,
    reference_halves: tuple[Tensor, Tensor],
) -> float:
    """`tmse_corrected` in dB; NaN where that is 0 or negative: the references are too noisy to tell."""
    return decibels_of_estimate(tmse_corrected(images, references, scale, mask, reference_halves=reference_halves))


def temporal_relmae(
    images: tuple[Tensor, Tensor],
    references: tuple[Tensor, Tensor],
    scale: Tensor | float,
    mask: Tensor | None = None,
) -> float:
    """Temporal relative mean absolute error on linear, exposed radiance, arguments as in `tpsnr`:

    mean(|ΔI - ΔR| / (R_i + 0.01)),    ΔI = I_i - I_{i-1},    ΔR = R_i - R_{i-1}
    """
    shown = exposed(scale, *images, *references)
    return masked_mean(_apart(shown).abs() / (shown[-1].abs() + 0.01), mask)


def _apart(shown: list[Tensor]) -> Tensor:
    """ΔI - ΔR of I_{i-1}, I_i, R_{i-1} and R_i."""
    before, now, before_r, now_r = shown
    return (now - before) - (now_r - before_r)


def recent_masks(masks: Sequence[Tensor], i: int) -> tuple[Tensor, Tensor, Tensor]:
    """M⁰, M¹, M² of frame i: the occlusion masks of frames i, i - 1 and i - 2; missing ones are M⁰ (the paper, §4.4).
    Errors inside them show a region one, two and three frames after it was uncovered."""
    return tuple(masks[i - k] if i >= k else masks[i] for k in range(3))


def ghost_length(
    images: Sequence[Tensor],  # consecutive frames, [1, 3, H, W] linear radiance
    references: Sequence[Tensor],
    motions: Sequence[Tensor],  # [1, 2, H, W] previous - current
    masks: Sequence[Tensor],  # [1, 1, H, W] bool: M_i, uncovered in frame i
    scale: Tensor | float,
    settled: int = 6,  # frames
) -> float:
    """Frames until an uncovered region has its final error; 0: at once.

    The age of a pixel is the number of frames since its surface was uncovered: 0 inside M_i, elsewhere 1 + the age of
    the pixel that `motion` leads to (nearest), none where that pixel has none or is off the screen. E(k) is the mean
    squared display error of all pixels of age k in all frames, E(∞) of all ages ≥ `settled`.

        ghost length = min{k : E(j) ≤ 1.1 · E(∞) for all ages j with k ≤ j < settled}

    and `settled` if E(settled - 1) is still higher. NaN if no pixel has an age ≥ `settled`, or no pixel a smaller one.
    Ages without pixels are skipped.
    """
    ghost = Ghost(settled)
    for image, reference, age in zip(images, references, ages(motions, masks), strict=True):
        ghost.add(image, reference, age, scale)
    return ghost.length


class Ghost:
    """`ghost_length`, one frame after the other."""

    def __init__(self, settled: int = 6) -> None:
        self.settled = settled
        self.total = torch.zeros(settled + 1, dtype=torch.float64)  # of errors at each age
        self.count = torch.zeros(settled + 1, dtype=torch.float64)

    def add(self, image: Tensor, reference: Tensor, age: Tensor, scale: Tensor | float) -> None:
        """Count a frame, whose pixels have these `ages`."""
        a, r = displayed(scale, image, reference)
        error = (a - r).square().mean(1, keepdim=True).double()
        known = age.isfinite()
        index = age[known].clamp(max=self.settled).long().cpu()
        self.total.index_add_(0, index, error[known].cpu())
        self.count.index_add_(0, index, torch.ones(len(index), dtype=torch.float64))

    @property
    def length(self) -> float:
        """In frames, of those so far."""
        total, count, settled = self.total, self.count, self.settled
        if count[settled] == 0 or count[:settled].sum() == 0:
            return math.nan
        limit = 1.1 * (total / count)[settled]
        above = [k for k in range(settled) if count[k] and total[k] / count[k] > limit]
        return float(above[-1] + 1) if above else 0.0


def ages(motions: Iterable[Tensor], masks: Iterable[Tensor]) -> Iterator[Tensor]:
    """Age of each pixel as `ghost_length` defines it, `[1, 1, H, W]` float; inf: none."""
    before = None
    for motion, mask in zip(motions, masks, strict=True):
        older = torch.full_like(motion[:, :1], math.inf) if before is None else fetch(before, motion) + 1
        before = torch.where(mask, 0.0, torch.where(on_screen(motion), older, math.inf))
        yield before


def fovvideovdp(
    images: Sequence[Tensor],  # consecutive frames, [1, 3, H, W] linear radiance
    references: Sequence[Tensor],
    scale: Tensor | float,
    frames_per_second: float = 30.0,
) -> float:
    """Quality of the sequence to an observer, in just-objectionable differences: 10 is perfect, lower is worse.

    FovVideoVDP (Mantiuk et al. 2021) without foveation, on the display transform, for its `standard_4k` display. Raises
    InputError where `pyfvvdp` is not installed: its licence forbids commercial use, so no extra installs it.
    """
    try:
        import pyfvvdp
    except ImportError:
        raise InputError("metric fovvideovdp needs pyfvvdp (CC BY-NC 4.0): pip install pyfvvdp") from None
    test, reference = (torch.cat([display(x, scale) for x in xs]).permute(0, 2, 3, 1) for xs in (images, references))
    metric = pyfvvdp.fvvdp(display_name="standard_4k", quiet=True, device=torch.device("cpu"))
    quality, _ = metric.predict(
        test.cpu().numpy(), reference.cpu().numpy(), dim_order="FHWC", frames_per_second=frames_per_second
    )
    return float(quality)
