"""The state that one frame on the GPU hands to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from ..frame import RECENT, SHIFTS
from .context import GpuArray


@dataclass(frozen=True)
class History:
    """`rtdenoise.frame.History` as images [H, W, 4] on the GPU, passed in and returned."""

    denoised: GpuArray  # the denoised previous frame: rgb, 1. The 1 is the flag ON_SCREEN, for still frames
    surface: GpuArray  # normal, depth
    vectors: GpuArray | None  # motion, motion_next; None: dual motion next time is approximate
    mean: GpuArray | None = None  # rgb, length: the running mean of light; None for models that keep none
    mean_albedo: GpuArray | None = None  # rgb: the running mean of albedo, likewise
    recent: tuple[GpuArray, ...] = ()  # [5, H, W] uint32 each, or 8: recent frames, the last one first
    noisy: GpuArray | None = None  # rgb: the radiance of the previous frame; likewise, as the next two
    found: GpuArray | None = None  # [h, w, 4] shifts of cells that the previous frame found in its picture
    shifts: tuple[GpuArray, ...] = ()  # [h, w, 4] each: those that count, of the previous frame and of recent ones

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.denoised.shape[0], self.denoised.shape[1]

    def read(self) -> dict[str, np.ndarray]:
        """Field of `rtdenoise.frame.History` -> [1, C, H, W], without the fields that are None."""
        denoised, surface = self.denoised.read(), self.surface.read()
        planes = {"radiance": denoised[..., :3], "normal": surface[..., :3], "depth": surface[..., 3:]}
        if self.vectors is not None:
            planes["motion_next"] = self.vectors.read()[..., 2:]
        if self.mean is not None:
            mean, albedo = self.mean.read(), self.mean_albedo.read()
            planes |= {"mean": mean[..., :3], "length": mean[..., 3:], "mean_albedo": albedo[..., :3]}
        if self.noisy is not None:
            planes["noisy"] = self.noisy.read()[..., :3]
        if self.found is not None:
            planes["found"] = self.found.read()[..., :2]
        planes |= {f"{SHIFTS}{i}": shift.read()[..., :2] for i, shift in enumerate(self.shifts)}
        recent = {f"{RECENT}{i}": kept.read()[None].view(np.int32) for i, kept in enumerate(self.recent)}
        return {name: np.ascontiguousarray(np.moveaxis(plane, 2, 0)[None]) for name, plane in planes.items()} | recent

    @classmethod
    def upload(cls, ctx: moderngl.Context, arrays: Mapping[str, np.ndarray]) -> History:
        """The inverse of `read`. Raises KeyError where radiance, normal or depth is missing."""

        def image(*planes: np.ndarray) -> GpuArray:
            planes = np.concatenate([np.asarray(plane, np.float32)[0] for plane in planes])
            return GpuArray.upload(ctx, np.moveaxis(np.pad(planes, ((0, 4 - len(planes)), (0, 0), (0, 0))), 0, 2))

        vectors = mean = mean_albedo = None
        noisy, found = (image(arrays[name]) if name in arrays else None for name in ("noisy", "found"))
        if "motion_next" in arrays:
            vectors = image(arrays["motion_next"], arrays["motion_next"])  # nobody reads motion, which comes first
        if "mean" in arrays:
            mean, mean_albedo = image(arrays["mean"], arrays["length"]), image(arrays["mean_albedo"])
        surface = image(arrays["normal"], arrays["depth"])
        denoised = image(arrays["radiance"], np.ones_like(arrays["depth"]))
        kept = [arrays[f"{RECENT}{i}"] for i in range(sum(name.startswith(RECENT) for name in arrays))]
        recent = [GpuArray.upload(ctx, words[0].view(np.uint32), np.uint32) for words in kept]
        count = sum(name.startswith(SHIFTS) for name in arrays)
        shifts = tuple(image(arrays[f"{SHIFTS}{i}"]) for i in range(count))
        return cls(denoised, surface, vectors, mean, mean_albedo, tuple(recent), noisy, found, shifts)
