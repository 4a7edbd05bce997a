"""The last convolution of a network that writes pixels: a few planes in float32, whatever the dtype of the features."""

from __future__ import annotations

from contextlib import nullcontext

import torch
from torch import Tensor
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back

SUPPORT = Support(halves=("x",), channels_last=True)
FUSED = Fused("to_planes", native=SUPPORT, triton=SUPPORT)
LANES = 16  # the fused op takes multiples of as many channels
MOST = 4  # planes that it makes at once


@falls_back
def to_planes(
    x: Tensor,  # [B, C, H, W] features
    weight: Tensor,  # [O, C, 3, 3]
    bias: Tensor,  # [O]
) -> Tensor:  # [B, O, H, W] float32
    """A 3×3 convolution with zeros around the image, summed and written in float32: eight bits of a bfloat16 would be
    seen in a picture.

    A fused one pays because libraries convert all features beforehand, and fill their registers with planes that are
    not there.
    """
    O, C = weight.shape[:2]
    last = x.is_contiguous(memory_format=torch.channels_last) and C % LANES == 0 and O <= MOST
    fits = weight.shape == (len(bias), x.shape[1], 3, 3)  # torch says what does not
    trained = torch.is_grad_enabled() and (weight.requires_grad or bias.requires_grad)
    taken = x.dtype != torch.float16 or x.device.type != "cpu"
    if last and fits and not trained and taken and (run := FUSED(x=x)):
        return run(x, weight, bias)
    with nullcontext() if x.is_meta else torch.autocast(x.device.type, enabled=False):
        return F.conv2d(x.float(), weight.float(), bias.float(), padding=1)
