"""Convolutions in half precision on CPUs that lack it: torch takes up to a hundred times as long as in float32."""

import functools

import torch
import torch.nn.functional as F


def install():
    """On such a CPU convolve rounded numbers in float32 and round the results, as hardware does that has bfloat16."""
    if torch.ops.mkldnn._is_mkldnn_bf16_supported():
        return
    for name in ("conv2d", "conv_transpose2d"):
        setattr(F, name, _in_float32(getattr(F, name)))


def _in_float32(convolve):
    @functools.wraps(convolve)
    def rounded(x, weight, bias=None, *shape, **named):
        autocast = torch.is_autocast_enabled("cpu")
        dtype = torch.get_autocast_dtype("cpu") if autocast and x.dtype != torch.float64 else x.dtype
        if x.device.type != "cpu" or dtype not in (torch.bfloat16, torch.float16):
            return convolve(x, weight, bias, *shape, **named)
        numbers = [None if t is None else t.to(dtype).float() for t in (x, weight, bias)]
        with torch.autocast("cpu", enabled=False):
            return convolve(*numbers, *shape, **named).to(dtype)

    return rounded
