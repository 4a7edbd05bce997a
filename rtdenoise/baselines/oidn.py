"""Intel Open Image Denoise (OIDN): the frame-by-frame denoiser that renderers ship.

`Oidn` is the method, `OidnFilter` one committed filter, to time the filter alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import torch
from torch import Tensor

from ..errors import InputError
from ..frame import Frame, History
from ..sanitise import sanitise
from .accumulate import Accumulate


def installed() -> bool:
    """Whether `pyoidn` is there, with all that it needs."""
    try:
        import pyoidn  # noqa: F401
    except ImportError:
        return False
    return True


@dataclass(frozen=True)
class Oidn:
    """OIDN's RT filter on HDR radiance with the frame's albedo and normal, frame by frame."""

    quality: str = "high"  # high | balanced | fast
    prefilter: bool = False  # denoise albedo and normal first, as OIDN's manual advises, and declare them clean
    clean: bool = False  # albedo and normal are free of noise, as `prefiltered` makes them
    accumulate: str = "none"  # input: filter the accumulated signal; output: accumulate the filtered signal
    alpha: float = 0.5  # of that accumulation
    _filters: dict[tuple[str, ...], OidnFilter] = field(default_factory=dict, init=False, repr=False, compare=False)

    def step(self, frame: Frame, history: History | None = None) -> tuple[Tensor, History | None]:
        """As `TemporalKPN.step`, for batches of one. There is a history only where something is accumulated.

        The first frame sets the filters up; later ones only filter. Raises InputError where
        `pyoidn` is not installed, and where albedo or normal is missing.
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

    def prefiltered(self, frame: Frame) -> Frame:
        """The (sanitised) frame with its albedo and normal denoised, each by itself."""
        images = filter_inputs(frame)
        return replace(frame, **{name: self._run({name: images[name]}) for name in ("albedo", "normal")})

    def _filter(self, frame: Frame) -> Tensor:
        return self._run(filter_inputs(self.prefiltered(frame) if self.prefilter else frame))

    def _run(self, images: dict[str, Tensor]) -> Tensor:
        """The filter of these inputs, set up again where size or device have changed."""
        kept = self._filters.get(tuple(images))
        if kept is None or not kept.fits(images):
            if kept is not None:
                kept.release()
            clean = (self.prefilter or self.clean) and "color" in images
            kept = self._filters[tuple(images)] = OidnFilter(images, self.quality, clean)
        return kept(images)


def filter_inputs(frame: Frame) -> dict[str, Tensor]:
    """OIDN's input for a (sanitised) frame, in OIDN's ranges and under its names."""
    return {"color": frame.radiance, "albedo": frame.albedo.clamp(0, 1), "normal": frame.normal.clamp(-1, 1)}


class OidnFilter:
    """One committed RT filter with images of its own, `[H, W, 3]`, on the device of `images`.

    `load` copies inputs, `execute` filters and returns when that is done, `result` is the output; a call does all
    three. Raises InputError for OIDN's errors, and where `pyoidn` is not installed.
    """

    def __init__(self, images: Mapping[str, Tensor], quality: str = "high", clean: bool = False) -> None:
        """`images`: OIDN's name ("color", "albedo", "normal") -> `[1, 3, H, W]`. `quality`: high | balanced | fast.
        `clean`: albedo and normal are free of noise."""
        first = next(iter(images.values()))
        self.device = _device(first.device)
        import pyoidn

        self.images = {
            name: torch.empty(*first.shape[2:], 3, device=first.device, dtype=torch.float32)
            for name in (*images, "output")
        }
        self.filter = pyoidn.Filter(self.device, pyoidn.OIDN_FILTER_TYPE_RT)
        for name, image in self.images.items():
            self.filter.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        if "color" in images:
            self.filter.set_bool("hdr", True)
            self.filter.set_bool("cleanAux", clean)
        self.filter.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{quality.upper()}"))
        self.filter.commit()
        self._check()
        self.load(images)

    def __call__(self, images: Mapping[str, Tensor]) -> Tensor:
        self.load(images)
        self.execute()
        return self.result

    def load(self, images: Mapping[str, Tensor]) -> None:
        for name, image in images.items():
            self.images[name].copy_(image[0].permute(1, 2, 0))

    def execute(self) -> None:
        self.filter.execute()
        self._check()

    @property
    def result(self) -> Tensor:
        """`[1, 3, H, W]`."""
        return self.images["output"].permute(2, 0, 1)[None].contiguous()

    def fits(self, images: Mapping[str, Tensor]) -> bool:
        """Whether these images have the filter's size and device."""
        image, own = next(iter(images.values())), self.images["output"]
        return image.shape[2:] == own.shape[:2] and image.device == own.device

    def release(self) -> None:
        self.filter.release()

    def _check(self) -> None:
        if message := self.device.get_error():
            raise InputError(f"OIDN: {message}")


@cache
def _device(device: torch.device):
    """OIDN's device for a torch device: one for all filters."""
    if not installed():
        raise InputError("method oidn needs pyoidn: pip install 'rtdenoise[bench]'")
    import pyoidn

    found = pyoidn.Device.from_torch(device)
    found.commit()
    if message := found.get_error():
        raise InputError(f"OIDN: {message}")
    return found
