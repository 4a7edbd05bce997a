"""Valid frames: values that no filter can use are replaced once, before any filter sees them."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError
from .frame import NOTHING_KNOWN, Frame, Known

if TYPE_CHECKING:
    from torch import Tensor

FAR = 1e9  # depth of a miss: renderers write inf, FLT_MAX or 1e10 there
BRIGHTEST = 1e15  # radiance; its square is finite in float32
# Above valid values, but not far: Cycles' denoising albedo of a mirror reaches 41. With albedo clipped at 16 bfloat16
# and float32 differed by 15 % there, clipped at 2 by 0.5 % (99.9th percentile).
GREATEST_ALBEDO, LONGEST_NORMAL = 2.0, 2.0
FINITE = (-3.4028234663852886e38, 3.4028234663852886e38)
VALID = {  # smallest and largest value of a layer; `sanitise` replaces the others
    "radiance": (0.0, BRIGHTEST), "components": (0.0, BRIGHTEST), "albedo": (0.0, GREATEST_ALBEDO),
    "normal": (-LONGEST_NORMAL, LONGEST_NORMAL),
    "depth": (0.0, 999999936.0), "motion": FINITE, "motion_next": FINITE,  # depth: the float32 before FAR
}  # fmt: skip


def admit(
    frame: Frame, previous: Tensor | None, known: Known = NOTHING_KNOWN, any_float: bool = False
) -> Frame:
    """Check and sanitise a frame for a step that filters along surfaces.

    `previous` is the image in the history, None without one. Raises InputError where `frame` is no Frame of tensors, or
    these are not float32 (unless `any_float`: the network has the frame's dtype), where albedo, normal, depth or (with
    history) motion is missing, and where the history is of another size.
    """
    if not isinstance(frame, Frame) or isinstance(frame.radiance, np.ndarray):
        found = f"a Frame of {type(frame.radiance).__name__}" if isinstance(frame, Frame) else type(frame).__name__
        raise InputError(
            f"step takes a rtdenoise.Frame of torch tensors [B, C, H, W], got {found}; rtdenoise.Denoiser takes numpy "
            "arrays and tensors, also [H, W, 3]"
        )
    for name, tensor in frame.layers():
        if name in VALID and str(tensor.dtype) != "torch.float32" and not any_float:
            raise InputError(f"{frame.name or 'frame'}: {name} is {tensor.dtype}, step takes torch.float32: "
                             "frame.to(torch.float32); rtdenoise.Denoiser takes any floats")  # fmt: skip
    frame = frame if known.sanitised else sanitise(frame)
    frame.require("albedo", "normal", "depth", *(() if previous is None else ("motion",)), previous=previous)
    return frame


def sanitise(frame: Frame) -> Frame:
    """Replace values that no filter can use. Valid frames come back unchanged to the bit, on a CPU as the same tensors.

    | layer               | found                 | becomes |
    |---------------------|-----------------------|---------|
    | radiance            | NaN, ±Inf, negative   | 0       |
    | radiance            | above 1e15            | 1e15 (its square is finite in float32) |
    | radiance            | a firefly             | `exposure.limit_fireflies` dims it |
    | components          | as in radiance        | as there; but fireflies stay, the stuck chains of a Metropolis |
    |                     |                       | renderer, which carry real energy |
    | albedo              | NaN, ±Inf, negative   | 0       |
    | albedo              | above 2               | 2       |
    | normal              | NaN, ±Inf             | 0       |
    | normal              | beyond ±2             | ±2      |
    | depth               | NaN, negative         | 0 (nothing hit) |
    | depth               | above 1e9, Inf        | 0: a miss, and no fault |
    | motion, motion_next | NaN, ±Inf             | `OFF_SCREEN`, so no history is taken |

    `faults` counts these pixels. References, position, id and samples are left as they are.
    """
    from .exposure import limit_fireflies
    from .ops.replace_invalid import replace_invalid

    clean = replace_invalid({layer: tensor for layer, tensor in frame.layers() if layer in VALID}, VALID)
    clean["radiance"] = limit_fireflies(clean["radiance"])
    return replace(frame, **clean)


def valid(layer: str, array: np.ndarray) -> np.ndarray:
    """`sanitise` of one layer as a numpy array, except for fireflies; without torch. Not for depth and motion."""
    low, high = VALID[layer]
    return np.nan_to_num(array, nan=0.0, posinf=0.0, neginf=0.0).clip(low, high)


def faults(frame: Frame) -> dict[str, int]:
    """Count the pixels that `sanitise` will replace: "layer: fault" -> count, without the zeros. For tensors on the CPU
    or numpy arrays; fireflies are counted where torch is installed."""
    found: dict[str, np.ndarray] = {}
    for layer, tensor in frame.layers():
        array = np.asarray(tensor)
        low, high = VALID.get(layer, (np.inf, -np.inf))
        undoubted = bool(low <= array.min() and array.max() <= high)  # most layers of most frames; not with a NaN
        if undoubted and layer == "radiance":
            found["radiance: firefly"] = _fireflies(array)
        if undoubted:
            continue
        finite = np.isfinite(array)
        if layer in ("radiance", "components", "albedo", "normal", "motion", "motion_next"):
            found[f"{layer}: NaN or Inf"] = ~finite
        if layer in ("radiance", "components", "albedo"):
            found[f"{layer}: negative"] = finite & (array < 0)
        if layer in ("radiance", "components"):
            found[f"{layer}: too bright"] = finite & (array > BRIGHTEST)
        if layer == "radiance":
            found["radiance: firefly"] = _fireflies(np.where(finite, array, 0).clip(0.0, BRIGHTEST))
        if layer == "albedo":
            found[f"albedo: above {GREATEST_ALBEDO:g}, as of lamps"] = finite & (array > GREATEST_ALBEDO)
        if layer == "normal":
            found["normal: too long"] = finite & (abs(array) > LONGEST_NORMAL)
        if layer == "depth":
            found["depth: NaN or negative"] = np.isnan(array) | (array < 0)
    counts = {what: int(mask.any(axis=1).sum()) for what, mask in found.items()}
    return {what: count for what, count in counts.items() if count}


def _fireflies(radiance: np.ndarray) -> np.ndarray:
    """The pixels that `exposure.limit_fireflies` changes."""
    if find_spec("torch") is None:
        return np.zeros(radiance.shape, bool)
    import torch

    from .exposure import limit_fireflies

    tensor = torch.from_numpy(radiance)
    return (limit_fireflies(tensor) != tensor).numpy()
