"""OIDN's filter alone, set up once a quality: `pyoidn.denoise` would set its one filter up anew at every change of
quality, in the time of a call."""

from __future__ import annotations

from collections.abc import Callable

import pyoidn
from torch import Tensor

from rtdenoise.frame import Frame


def oidn_filter(frame: Frame, quality: str) -> Callable[[], Tensor]:
    """A function that denoises the frame (batch of one) on its device, and returns `[H, W, 3]` when that is done."""
    layers = {
        pyoidn.OIDN_IMAGE_COLOR: frame.radiance, pyoidn.OIDN_IMAGE_ALBEDO: frame.albedo,
        pyoidn.OIDN_IMAGE_NORMAL: frame.normal, pyoidn.OIDN_IMAGE_OUTPUT: frame.radiance,
    }  # fmt: skip
    images = {name: layer[0].permute(1, 2, 0).clone().contiguous() for name, layer in layers.items()}
    device = pyoidn.Device.from_torch(frame.radiance)
    device.commit()
    denoise = pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT)
    for name, image in images.items():
        denoise.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
    denoise.set_bool("hdr", True)
    denoise.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{quality.upper()}"))
    denoise.commit()

    def execute() -> Tensor:
        denoise.execute()
        if error := device.get_error():
            raise RuntimeError(f"OIDN: {error}")
        return images[pyoidn.OIDN_IMAGE_OUTPUT]

    return execute
