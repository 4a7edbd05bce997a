"""Pixels that know less than those around them: how their light is evened out, and what the noisy frame tells of
them."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import MIX_SEEN_ONCE
from .around import greatest_around
from .dispatch import Fused, Support, falls_back

IMAGES = {"light": (3,), "count": (1,), "image": (3,), "trust": (1,)}
FLAGS = Support(max_channels=1, bytes=("flags",))
EVENED = Fused("evened", native=Support(channels=IMAGES), triton=Support(channels=IMAGES))
TOLD = Fused("evened.held_and_tells", native=FLAGS, triton=FLAGS)


@falls_back
def evened(
    light: Tensor,  # [B, 3, H, W] averaged light
    count: Tensor,  # [B, 1, H, W] the frames in it
    image: Tensor,  # [B, 3, H, W] denoised
    trust: Tensor,  # [B, 1, H, W] in [0, 1], in the image
) -> Tensor:  # [B, 3, H, W]
    """Averaged light with some of the denoised image where one to two frames are in it and more in pixels around:
    networks that see a single picture take noise for texture where there is less of it nearby. As far as the image is
    trusted. To the bit the light where one frame is in all pixels around."""
    if run := EVENED(light=light, count=count, image=image, trust=trust):
        return run(light, count, image, trust)
    once = 1 - (count - 1).clamp(0, 1)
    return torch.lerp(image, light, 1 - (1 - MIX_SEEN_ONCE) * trust * once * (greatest_around(count) - 1).clamp(0, 1))


@falls_back
def held_and_tells(
    held: Tensor,  # [B, 1, H, W] bool, or numbers in [0, 1]: whether a pixel has a history
    dtype: torch.dtype,  # of the results
) -> tuple[Tensor, Tensor]:  # [B, 1, H, W] in [0, 1] both
    """`held` in numbers, and how far the noisy frame tells of each pixel (`ops.mix`): where it was just uncovered and
    others around have a history, the frame tells of these, not of it."""
    given = {"flags": held.view(torch.uint8)} if held.dtype is torch.bool else {"held": held}
    if dtype is torch.float32 and (run := TOLD(**given)):
        return run(held)
    held = held.to(dtype)
    return held, held + (1 - held) * (1 - greatest_around(held))
