"""Shared by the ops that read logits: constants and memory layout, as logits.h expects them."""

from __future__ import annotations

import math
from ctypes import Array, c_int64

import torch
from torch import Tensor

from ..logits import in_planes, strides, whole

CODES = {torch.float32: 0, torch.bfloat16: 1, torch.float16: 2}  # LOGIT of logits.h


def constants(image: Tensor, logits: Tensor) -> dict[str, int]:
    """K, C and LOGIT of a kernel over `image`."""
    return {"K": math.isqrt(logits.shape[-3]), "C": image.shape[1], "LOGIT": CODES[logits.dtype]}


def layout(logits: Tensor) -> Array[c_int64]:
    """The struct Layout of logits.h."""
    return (c_int64 * 6)(*strides(logits))


def readable(logits: Tensor) -> Tensor:
    """Logits as `read_logits` wants them: values adjacent along x or along k. Planes, channels last and slices of
    their channels are not copied."""
    if in_planes(logits) or strides(logits)[1] == 1 or logits.shape[-3] == 1:
        return logits
    return (whole(logits) if logits.ndim == 6 else logits).contiguous()
