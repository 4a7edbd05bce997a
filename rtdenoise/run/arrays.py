"""Convert the caller's arrays, numpy or torch, to planes `[B, C, H, W]` and back."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..constants import MAX_HALF
from ..errors import InputError

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class Form:
    """The layout, dtype and device of the caller's picture, for the result."""

    last: bool  # channels last, [H, W, C]; else [B, C, H, W]
    dtype: Any
    device: Any  # None: a numpy array


def to_planes(
    name: str,  # for messages
    array: Any,  # [H, W, C], [B, C, H, W], or with one channel [H, W]; floats of any width, numpy or torch
    channels: int,
) -> tuple[np.ndarray | Tensor, Form]:
    """A float32 copy `[B, C, H, W]`, a tensor where `array` is one, and the form of `array`.

    Raises InputError for anything else, naming the expected form.
    """
    if not is_tensor(array):
        array = _as_numpy(name, array)
    _expect_floats(name, array)
    shape = tuple(array.shape)
    if len(shape) == 2 and channels == 1:
        array = array[..., None]
    elif not (len(shape) == 3 and shape[2] == channels) and not (len(shape) == 4 and shape[1] == channels):
        raise InputError(f"{name}: {_expected(channels)}, got {list(shape)}{_advice(shape, channels)}")
    if 0 in shape:
        raise InputError(f"{name}: {_expected(channels)}, got an empty array {list(shape)}")
    form = Form(len(shape) < 4, array.dtype, array.device if is_tensor(array) else None)
    return _copied(array, form.last), form


def from_planes(image: np.ndarray | Tensor, form: Form) -> np.ndarray | Tensor:
    """A picture `[B, C, H, W]` as a new array of `form`. Values beyond a half float's range become its largest."""
    if form.device is None:
        image = image if isinstance(image, np.ndarray) else image.cpu().numpy()
        if form.dtype == np.float16:
            image = image.clip(max=MAX_HALF)
        return np.array(np.moveaxis(image[0], 0, 2) if form.last else image, form.dtype, order="C")
    import torch

    image = torch.as_tensor(image)
    if form.dtype == torch.float16:
        image = image.clamp(max=MAX_HALF)
    image = (image[0].permute(1, 2, 0) if form.last else image).to(form.device, form.dtype, copy=True)
    return image.contiguous()


def is_tensor(array: Any) -> bool:
    """Whether this is a torch tensor; does not import torch to find out."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(array, torch.Tensor)


def _as_numpy(name: str, array: Any) -> np.ndarray:
    if array is None or isinstance(array, str | bytes | dict):
        raise InputError(f"{name}: expected a numpy array or a torch tensor, got {type(array).__name__}")
    try:
        return np.asarray(array)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name}: expected a numpy array or a torch tensor, got {type(array).__name__} ({error})"
        ) from None


def _expect_floats(name: str, array: np.ndarray | Tensor) -> None:
    if is_tensor(array) and (array.is_nested or array.is_meta or str(array.layout) != "torch.strided"):
        kind = "nested" if array.is_nested else "meta" if array.is_meta else str(array.layout).removeprefix("torch.")
        raise InputError(f"{name}: expected a dense tensor that holds values, got a {kind} one")
    floats = array.dtype.is_floating_point if is_tensor(array) else array.dtype.kind == "f"
    if not floats:
        dtype = str(array.dtype).removeprefix("torch.")
        linear = "linear radiance, not a display-encoded 8-bit picture" if name == "color" else "float16, 32 or 64"
        raise InputError(f"{name}: expected floats ({linear}), got {dtype}")


def _copied(array: np.ndarray | Tensor, last: bool) -> np.ndarray | Tensor:
    """A copy: callers reuse their buffers for the next frame, and history keeps parts of this one."""
    if not is_tensor(array):
        with np.errstate(over="ignore"):  # beyond float32 is infinite, which is replaced later
            return np.array(np.moveaxis(array, 2, 0)[None] if last else array, np.float32, order="C")
    import torch

    planes = array.detach().permute(2, 0, 1)[None] if last else array.detach()
    return planes.to(torch.float32, copy=True).contiguous()


def _expected(channels: int) -> str:
    plain = "[H, W], " if channels == 1 else ""
    return f"expected {plain}[H, W, {channels}] or [B, {channels}, H, W]"


def _advice(shape: tuple[int, ...], channels: int) -> str:
    """Advice for shapes that are common mistakes."""
    if len(shape) == 3 and shape[0] == channels:
        return "; add the batch axis: array[None]"
    if len(shape) == 3 and shape[2] == 4 and channels == 3:
        return "; leave alpha out: array[..., :3]"
    if len(shape) == 4 and shape[3] == channels:
        return "; move the channels: numpy's array.transpose(0, 3, 1, 2), torch's array.permute(0, 3, 1, 2)"
    return ""
