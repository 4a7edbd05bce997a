"""The error of a sequence's pictures over the frame and in uncovered regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from rtdenoise.color import display_exposure
from rtdenoise.evaluate.sequence import uncovered
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse, mse_corrected

FEWEST = 500  # pixels uncovered in all frames together: fewer say nothing


def psnr_of_regions(frames: Sequence[Frame], images: Mapping[int, Tensor]) -> dict[str, float | None]:
    """PSNR of some frames' pictures, by the number of the frame: of all their pixels together (`frame`), and of those
    `uncovered`; None where these are few. Corrected where there are halves of the references."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))

    def mean(masks: Sequence[Tensor | None]) -> float | None:
        found = []
        for i, image in images.items():
            mask, frame = masks[i], frames[i]
            count = frame.depth.numel() if mask is None else int(mask.sum())
            if count and frame.reference_half is None:
                found.append((count, mse(image, frame.reference, scale, mask)))
            elif count:
                half = {"reference_half": frame.reference_half}
                found.append((count, mse_corrected(image, frame.reference, scale, mask, **half)))
        pixels = sum(count for count, _ in found)
        return decibels(sum(count * error for count, error in found) / pixels) if pixels >= FEWEST else None

    return {"frame": mean(len(frames) * [None]), "uncovered": mean(uncovered(frames))}
