"""Intel Open Image Denoise, frame by frame: the peer that a user would pick instead."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ..errors import InputError
from ..frame import Frame, sanitise


@dataclass(frozen=True)
class Oidn:
    """OIDN's RT filter on HDR radiance with the frame's albedo and normal. It has no history."""

    quality: str = "high"  # high | balanced | fast

    def step(self, frame: Frame, history: None = None) -> tuple[Tensor, None]:
        """As `TemporalKPN.step`, for batches of one. Raises InputError where `pyoidn` is not installed."""
        try:
            import pyoidn
        except ImportError:
            raise InputError("method oidn needs pyoidn: pip install 'rtdenoise[bench]'") from None
        frame = sanitise(frame)
        layers = (frame.radiance, frame.albedo.clamp(0, 1), frame.normal.clamp(-1, 1))
        color, albedo, normal = (layer[0].permute(1, 2, 0).contiguous() for layer in layers)
        image = pyoidn.denoise(color, albedo, normal, hdr=True, quality=self.quality)
        return image.permute(2, 0, 1)[None].contiguous(), None
