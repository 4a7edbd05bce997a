"""Promises of the operations in `ops` for extreme input, the same on every backend: the second table of cases.

A case gets a backend's operations by name, numpy in and out, and returns the greatest difference from its promise.
Values that are not finite count as an infinite difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import ModuleType

import numpy as np
import torch

from rtdenoise import ops

BACKENDS = ("torch float32", "torch bfloat16 logits", "torch float16 logits", "GLSL float32", "GLSL float16 logits")
LOGITS = {"apply_kernel": 1, "pick": 2}  # position among the arguments
Operation = Callable[..., np.ndarray]


def backend(label: str) -> Callable[[str], Operation]:
    """The operations of one of `BACKENDS`, by name; logits have the dtype that the label names."""
    if label.startswith("torch"):
        dtype = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}[label.split()[1]]

        def by_name(name: str) -> Operation:
            def run(*arrays: np.ndarray) -> np.ndarray:
                tensors = [torch.from_numpy(a) for a in arrays]
                if name in LOGITS:
                    tensors[LOGITS[name]] = tensors[LOGITS[name]].to(dtype)
                return _named(ops, name)(*tensors).numpy()

            return run

        return by_name
    from rtdenoise import glsl  # needs a driver

    logits = np.float16 if "float16" in label else np.float32

    def by_name(name: str) -> Operation:
        def run(*arrays: np.ndarray) -> np.ndarray:
            return _named(glsl, name)(*(a.astype(logits) if i == LOGITS.get(name) else a for i, a in enumerate(arrays)))

        return run

    return by_name


def _named(module: ModuleType, name: str) -> Callable:
    return partial(module.warp, cubic=True) if name == "cubic warp" else getattr(module, name)


@dataclass(frozen=True)
class OpCase:
    """`measure(op)` must be at most `bound`."""

    name: str
    promise: str
    bound: float
    measure: Callable[[Callable[[str], Operation]], float]


H, W = 13, 18


def _random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, dtype=np.float32)


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    with np.errstate(invalid="ignore"):
        error = np.abs(a.astype(np.float64) - b)
    return float(error.max()) if np.isfinite(error).all() else math.inf


def _kernel(op: Callable[[str], Operation], image: np.ndarray, logits: np.ndarray) -> np.ndarray:
    return op("apply_kernel")(image, logits)


def _one_tap(op: Callable[[str], Operation]) -> float:
    image, logits = _random(1, 3, H, W), np.full((1, 25, H, W), -1e4, np.float32)
    logits[:, 12] = 1e4
    return _difference(_kernel(op, image, logits), image)


def _even(op: Callable[[str], Operation], level: float) -> float:
    image = np.full((1, 3, H, W), 0.7, np.float32)
    return _difference(_kernel(op, image, np.full((1, 25, H, W), level, np.float32)), image)


def _bounded(op: Callable[[str], Operation], scale: float) -> float:
    """Excess over the brightest tap: the output is an average."""
    image, logits = _random(1, 3, H, W) * np.float32(scale), _random(1, 25, H, W, seed=1) * 2e4 - 1e4
    out = _kernel(op, image, logits.astype(np.float32))
    return max(0.0, float(out.max() / image.max()) - 1) if np.isfinite(out).all() else math.inf


def _one_cell(op: Callable[[str], Operation]) -> float:
    coarse, logits = _random(1, 3, (H + 1) // 2, W // 2), np.full((1, 9, H, W), -1e4, np.float32)
    logits[:, 4] = 1e4
    picked = op("pick")(_random(1, 3, H, W, seed=1), coarse, logits, np.ones((1, 1, H, W), np.float32))
    return _difference(picked, coarse.repeat(2, axis=2).repeat(2, axis=3)[:, :, :H])


def _alpha(op: Callable[[str], Operation], alpha: float) -> float:
    a, b = _random(1, 3, H, W), _random(1, 3, H, W, seed=1)
    out = op("blend")(a, b, np.full((1, 1, H, W), alpha, np.float32))
    return _difference(out, a if alpha else b)


def _coarse(op: Callable[[str], Operation], alpha: float) -> float:
    """α = 0 leaves the fine scale; α = 1 on equal scales too."""
    fine = _random(1, 3, 12, 18)
    coarse = op("downsample")(fine)
    out = op("compose")(fine, coarse, np.full((1, 1, 6, 9), alpha, np.float32))
    return _difference(out, fine)


def _warp(op: Callable[[str], Operation], name: str, motion: float, expected: str) -> float:
    image = _random(1, 3, H, W)
    field = np.zeros((1, 2, H, W), np.float32)
    field[:, 0] = motion
    wanted = {"same": image, "last column": np.broadcast_to(image[..., -1:], image.shape),
              "first column": np.broadcast_to(image[..., :1], image.shape),
              "mean of two": (image + np.concatenate([image[..., 1:], image[..., -1:]], -1)) / 2}  # fmt: skip
    return _difference(op(name)(image, field), wanted[expected])


def _between(op: Callable[[str], Operation], scale: float) -> float:
    """Distance from the range of the image."""
    image = (_random(1, 3, H, W) > 0.9) * np.float32(scale)
    out = op("cubic warp")(image, 8 * _random(1, 2, H, W, seed=1) - 4)
    return max(0.0, -float(out.min()), float(out.max()) - scale) if np.isfinite(out).all() else math.inf


def _one_pixel(op: Callable[[str], Operation]) -> float:
    image = np.full((1, 3, 1, 1), 0.7, np.float32)
    outs = [
        _kernel(op, image, _random(1, 25, 1, 1)),
        op("warp")(image, np.full((1, 2, 1, 1), 3.7, np.float32)),
        op("compose")(image, op("downsample")(image), np.full((1, 1, 1, 1), 0.5, np.float32)),
        op("pick")(image, image, _random(1, 9, 1, 1), np.full((1, 1, 1, 1), 0.5, np.float32)),
    ]
    return max(_difference(out, image) for out in outs)


def _bright(op: Callable[[str], Operation]) -> float:
    """Relative error of 1e15, the brightest value that `sanitise` admits, through every operation."""
    image = np.full((1, 3, H, W), 1e15, np.float32)
    half = np.full((1, 1, H, W), 0.5, np.float32)
    motion = np.full((1, 2, H, W), 0.3, np.float32)
    down = op("downsample")(image)
    outs = [_kernel(op, image, _random(1, 25, H, W)), op("blend")(image, image, half), op("warp")(image, motion),
            op("compose")(image, down, half[:, :, : down.shape[2], : down.shape[3]]),
            op("pick")(image, down, _random(1, 9, H, W), half), op("cubic warp")(image, motion)]  # fmt: skip
    return max(_difference(out, image) for out in outs) / 1e15


OP_CASES = [
    OpCase("apply_kernel: logits −1e4, one of +1e4", "that tap alone, exactly", 0.0, _one_tap),
    *(OpCase(f"apply_kernel: all logits {level:g}", "the mean; a constant image is kept", 1e-6,
             lambda op, level=level: _even(op, level)) for level in (0.0, 1e4, -1e4)),
    *(OpCase(f"apply_kernel: logits ±1e4, image of {scale:g}", "no brighter than the brightest tap, relative", 1e-6,
             lambda op, scale=scale: _bounded(op, scale)) for scale in (1e-30, 1.0, 1e15)),
    OpCase("pick: logits −1e4, one of +1e4", "that cell alone, exactly", 0.0, _one_cell),
    *(OpCase(f"blend: α = {alpha:g}", "one of the two, exactly", 0.0, lambda op, alpha=alpha: _alpha(op, alpha))
      for alpha in (0.0, 1.0)),
    *(OpCase(f"compose: α = {alpha:g}, scales that agree", "the fine scale", 1e-6,
             lambda op, alpha=alpha: _coarse(op, alpha)) for alpha in (0.0, 1.0)),
    *(OpCase(f"{name}: motion {motion:g}", f"{expected}", 0.0 if expected != "mean of two" else 1e-6,
             lambda op, name=name, motion=motion, expected=expected: _warp(op, name, motion, expected))
      for name, motion, expected in (
          ("warp", 0.0, "same"), ("warp", math.nan, "same"), ("warp", math.inf, "same"), ("warp", 1e6, "last column"),
          ("warp", -1e30, "first column"), ("warp", 0.5, "mean of two"), ("cubic warp", 0.0, "same"),
          ("cubic warp", math.nan, "same"), ("cubic warp", 1e6, "last column"), ("cubic warp", -1e30, "first column"),
          ("fetch", math.nan, "same"), ("fetch", 1e6, "last column"))),
    *(OpCase(f"cubic warp: pixels of 0 and {scale:g}", "within their range, exactly", 0.0,
             lambda op, scale=scale: _between(op, scale)) for scale in (1.0, 2.0**50)),
    OpCase("one pixel through every operation", "unchanged", 1e-6, _one_pixel),
    OpCase("radiance of 1e15 through every operation", "unchanged, relative", 1e-6, _bright),
]  # fmt: skip
