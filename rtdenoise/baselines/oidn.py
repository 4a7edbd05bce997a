"""Intel Open Image Denoise: the peer that a user would pick instead."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache

import torch
from torch import Tensor

from ..errors import InputError
from ..frame import Frame, History
from ..sanitise import sanitise
from .accumulate import Accumulate


@dataclass(frozen=True)
class Oidn:
    """OIDN's RT filter on HDR radiance with the frame's albedo and normal, frame by frame."""

    quality: str = "high"  # high | balanced | fast
    prefilter: bool = False  # albedo and normal are denoised first, as OIDN's manual advises, and then taken as clean
    accumulate: str = "none"  # input: the accumulated signal is filtered; output: what was filtered is accumulated
    alpha: float = 0.5  # of that accumulation
    _filters: dict[tuple[str, ...], _Filter] = field(default_factory=dict, init=False, repr=False, compare=False)

    def step(self, frame: Frame, history: History | None = None) -> tuple[Tensor, History | None]:
        """As `TemporalKPN.step`, for batches of one. Unless something is accumulated there is no history.

        Filters are set up with the first frame and kept: what is timed after it is the filtering. Raises InputError
        where `pyoidn` is not installed, and where albedo or normal is missing.
        """
        frame = sanitise(frame)
        frame.require("albedo", "normal")
        accumulate = Accumulate(self.alpha)
        if self.accumulate == "input":
            radiance, history = accumulate.step(frame, history)
            return self._filter(replace(frame, radiance=radiance)), history
        image = self._filter(frame)
        if self.accumulate == "output":
            return accumulate.step(replace(frame, radiance=image), history)
        return image, None

    def _filter(self, frame: Frame) -> Tensor:
        guides = {"albedo": frame.albedo.clamp(0, 1), "normal": frame.normal.clamp(-1, 1)}
        if self.prefilter:
            guides = {name: self._run(**{name: guide}) for name, guide in guides.items()}
        return self._run(color=frame.radiance, **guides)

    def _run(self, **images: Tensor) -> Tensor:
        """One filter on these inputs, set up anew where the size or the device is another than before."""
        kept = self._filters.get(tuple(images))
        if kept is None or not kept.fits(images):
            if kept is not None:
                kept.release()
            clean = self.prefilter and "color" in images
            kept = self._filters[tuple(images)] = _Filter(images, self.quality, clean)
        return kept(images)


class _Filter:
    """One committed filter with images of its own, `[H, W, 3]`, which frames are copied into."""

    def __init__(self, images: dict[str, Tensor], quality: str, clean: bool) -> None:
        first = next(iter(images.values()))
        self.device = _device(first.device)
        import pyoidn

        self.filter = pyoidn.Filter(self.device, pyoidn.OIDN_FILTER_TYPE_RT)
        _, channels, height, width = first.shape
        self.images = {name: first.new_empty(height, width, channels) for name in (*images, "output")}
        for name, image in self.images.items():
            self.filter.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        if "color" in images:
            self.filter.set_bool("hdr", True)
            self.filter.set_bool("cleanAux", clean)
        self.filter.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{quality.upper()}"))
        self.filter.commit()
        self._check()

    def __call__(self, images: dict[str, Tensor]) -> Tensor:
        for name, image in images.items():
            self.images[name].copy_(image[0].permute(1, 2, 0))
        self.filter.execute()
        self._check()
        return self.images["output"].permute(2, 0, 1)[None].contiguous()

    def fits(self, images: dict[str, Tensor]) -> bool:
        """Whether it was made for images of this size on this device."""
        image, own = next(iter(images.values())), self.images["output"]
        return image.shape[2:] == own.shape[:2] and image.device == own.device

    def release(self) -> None:
        self.filter.release()

    def _check(self) -> None:
        if message := self.device.get_error():
            raise InputError(f"OIDN: {message}")


@cache
def _device(device: torch.device):
    """OIDN's device beside torch's: one for all filters."""
    try:
        import pyoidn
    except ImportError:
        raise InputError("method oidn needs pyoidn: pip install 'rtdenoise[bench]'") from None
    found = pyoidn.Device.from_torch(device)
    found.commit()
    if message := found.get_error():
        raise InputError(f"OIDN: {message}")
    return found
