"""The layers that files hold. A layer has one name in EXR files, in clips and in `Frame`; this table lists them all.

Only layers of the signal have several: the layers of `Frame.radiance`, `reference` and `reference_half` depend on the
signal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Layer:
    """How a layer is stored."""

    components: str  # of its EXR channels, in order: `normal.X`, `normal.Y`, `normal.Z`; `color` is R, G, B alone
    exr_type: str = "half"  # of the EXR files that this project writes: "half", "float" or "uint"
    clip_type: type = np.float16
    in_every_clip: bool = True

    @property
    def channels(self) -> int:
        """How many channels it has."""
        return len(self.components)


# Not half: depth and motion would lose subpixel precision, and positions overflow.
LAYERS = {
    "color": Layer("RGB"),  # the noisy beauty
    "indirect": Layer("RGB"),  # the noisy indirect light
    "reference": Layer("RGB"),
    "indirect_reference": Layer("RGB"),
    "reference_half": Layer("RGB"),  # the mean of one half of the reference's samples
    "indirect_reference_half": Layer("RGB"),
    "albedo": Layer("RGB"),
    "normal": Layer("XYZ"),
    "depth": Layer("Z", "float", np.float32),
    "motion": Layer("XY", "float", np.float32),
    "motion_next": Layer("XY", "float", np.float32),
    "id": Layer("I", "uint", np.uint16),
    "position": Layer("XYZ", "float", np.float32, in_every_clip=False),
    "direct": Layer("RGB", in_every_clip=False),
    "samples": Layer("V", in_every_clip=False),  # samples per pixel
    "large": Layer("RGB", in_every_clip=False),  # beauty from large steps of a Metropolis renderer
    "small": Layer("RGB", in_every_clip=False),  # beauty from its small steps
    "proposals": Layer("RGB", in_every_clip=False),  # beauty path traced from its large proposals, accepted or not
    "albedo_reference": Layer("RGB", in_every_clip=False),  # of more samples: references are cleaned by them
    "normal_reference": Layer("XYZ", in_every_clip=False),
}
SIGNALS = {  # signal -> layer of `Frame` -> layer on disk
    "color": {"radiance": "color", "reference": "reference", "reference_half": "reference_half"},
    "indirect": {
        "radiance": "indirect", "reference": "indirect_reference", "reference_half": "indirect_reference_half",
    },
}  # fmt: skip
COMPONENTS = ("large", "small")  # the layers that `Frame.components` stacks, for the signal `color`
