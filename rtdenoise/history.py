"""The life of a history: where it can be used, when it ends, saving and loading, another picture size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .constants import ADVANCE_GAIN, ADVANCE_LEAST, ADVANCE_MOST, CUT_AROUND, CUT_UNMOVED, MOVES, SHIFT_CELL
from .data.stored import FOUND, read_history, seen_step, write_history
from .errors import InputError
from .frame import MAX_CUT_MISMATCH, NOTHING_KNOWN, RECENT, SHIFTS, Frame, History, Known
from .motion import on_screen, same_surface
from .ops import fetch
from .ops.alike import alike
from .ops.kept import kept_nearer, nearer
from .ops.ranks import median
from .ops.unlike import unlike
from .sanitise import sanitise

Step = Callable[..., tuple[Tensor, History]]  # of (frame, history, known)

# Must not be mixed across silhouettes.
NEAREST = ("depth", "normal", "motion_next", "length", "residual_length", "footprint_count")
CELLS = tuple(2**i for i in range(24))  # sides in pixels of what a pixel of a coarser layer stands for


def usable(frame: Frame, history: History) -> Tensor:
    """Pixels whose history can be used, `[B, 1, H, W]` bool: the surface was on the screen, and the surface seen there
    is alike (`motion.same_surface`). Every pixel counts as alike where history or frame has no depth or normal.

    `frame` needs `motion` and is expected to be sanitised.
    """
    return on_screen(frame.motion) & _alike(frame, history)


def mismatch(frame: Frame, history: History) -> Tensor:
    """How many more of the pixels with history on the screen find another surface there than find one beside
    themselves that moves alike, `[B]` in [0, 1]: with the shares m and b of these,

        max(0, m - b) / (1 - b)

    Through a veil, in fog, out of focus or among thin leaves one sample a pixel finds another surface everywhere,
    within a shot, too. So where this exceeds `frame.MAX_CUT_MISMATCH` it is CUT_AROUND times the share of those that
    find their surface in none of the eight pixels around, either, if that is less, or of those that do not find it as
    from a camera that has gone ahead (`advance`). Above it still, the frame belongs to another shot, whatever its
    motion vectors say. 0 where nothing was on the screen: such a history leaves no trace anyway.

    Where motion is zero in all pixels the picture should stand still. If more than MOVES find another surface, as after
    a render with motion blur, for which Cycles writes zeros, the result is CUT_UNMOVED times the share of those that
    find their surface nowhere around."""
    if _unknown(frame, history):
        return frame.motion.new_zeros(len(frame.motion))
    (H, W), surfaces = frame.size, (history.depth, history.normal)
    count, share, usual = unlike(frame.depth, frame.normal, frame.motion, *surfaces).to(frame.motion.dtype).unbind(1)
    count = count.clamp(min=1)
    share, usual = share / count, usual / (H * max(1, W - 1))
    found = (share - usual).clamp(min=0) / (1 - usual).clamp(min=1e-6)
    if not (found > MOVES).any():
        return found
    seen = on_screen(frame.motion)
    unmoved = ~(seen & (frame.motion != 0).any(1, keepdim=True)).flatten(1).any(1) & (found > MOVES)
    if not (unmoved | (found > MAX_CUT_MISMATCH)).any():
        return found
    around = found.new_tensor([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]).view(-1, 1, 2, 1, 1)
    somewhere = sum(_alike(frame, history, offset) for offset in around) > 0
    lost = (seen & ~somewhere).sum((1, 2, 3)) / count
    nowhere = torch.minimum(lost, _lost_ahead(frame, history, seen) / count)
    return (CUT_UNMOVED * lost).clamp(max=1).where(unmoved, torch.minimum(found, CUT_AROUND * nowhere))


def _lost_ahead(frame: Frame, history: History, seen: Tensor) -> Tensor:
    """How many of the pixels `seen` find another surface where the camera has gone ahead (`advance`), `[B]`: then every
    depth is another, as in another shot."""
    depth = nearer(history.depth, advance(frame, history.depth, history.normal))
    found = same_surface(frame.depth, frame.normal, depth, history.normal, frame.motion)
    return (seen & ~found).sum((1, 2, 3))


def advance(frame: Frame, depth: Tensor | None, normal: Tensor | None) -> Tensor:
    """How far the camera has gone ahead, in units of depth, `[B, 1, 1, 1]`: the median of how much nearer the same
    places are than in the frame before, with `depth` and `normal`. 0 where that is too little or too much to be so
    (`constants.ADVANCE_LEAST`, ...), where it does not lead more of the pixels to their surface, and where a layer is
    missing, or has another size. Of every `seen_step`-th pixel."""
    layers, step = (frame.depth, frame.normal, frame.motion, depth, normal), seen_step(frame.size)
    if any(layer is None or layer.shape[2:] != frame.size for layer in layers):
        return frame.radiance.new_zeros(len(frame.radiance), 1, 1, 1)
    near, facing, motion, *before = (layer[..., ::step, ::step].contiguous() for layer in layers)
    far, faced = (fetch(layer, motion / step) for layer in before)
    seen = on_screen(motion / step)
    both = seen & (near > 0) & (far > 0)
    by, way = (median(x.where(both, torch.nan).flatten(1)) for x in (far - near, near))
    by = by.where((by.abs() > ADVANCE_LEAST * way) & (by.abs() < ADVANCE_MOST * way), 0)
    if not by.any():
        return by
    found, more, count = (
        (seen & there).sum((1, 2, 3), keepdim=True)
        for there in (*(alike((near, facing), (x, faced)) for x in (far, nearer(far, by))), seen)
    )
    return by.where(more - found > ADVANCE_GAIN * count, 0)


def advanced(frame: Frame, before: Frame) -> Tensor:
    """`advance` from one frame to the next."""
    return advance(frame, before.depth, before.normal)


def going_ahead(step: Step, advanced: Callable[[Frame, Frame], Tensor] = advanced) -> Step:
    """A denoiser's step with the history, and the frames ahead, as from the camera of its frame, where that goes ahead
    (`advance`). Surfaces are told by their depth: those that are near would be others in each frame."""

    def taken(frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN) -> tuple[Tensor, History]:
        frame = frame if known.sanitised else sanitise(frame)
        if history is not None and (by := advance(frame, history.depth, history.normal)).any():
            recent = tuple(kept_nearer(kept, by) for kept in history.recent)
            history = replace(history, depth=nearer(history.depth, by), recent=recent)
        ahead, before, total = [], frame, 0
        for other in known.ahead:
            total = total + advanced(other, before)
            ahead.append(replace(other, depth=nearer(other.depth, -total)) if total.any() else other)
            before = other
        if any(a is not b for a, b in zip(ahead, known.ahead, strict=True)):
            known = replace(known, turning=(), coming=())
        return step(frame, history, replace(known, sanitised=True, ahead=tuple(ahead)))

    return taken


def _unknown(frame: Frame, history: History) -> bool:
    """Whether one of them does not tell its surfaces. Then all are alike."""
    return any(layer is None for layer in (frame.depth, frame.normal, history.depth, history.normal))


def _alike(frame: Frame, history: History, offset: Tensor | float = 0.0) -> Tensor:
    """Whether the surface is alike at the end of the motion, or so many pixels beside."""
    if _unknown(frame, history):
        return torch.ones_like(frame.motion[:, :1], dtype=torch.bool)
    return same_surface(frame.depth, frame.normal, history.depth, history.normal, frame.motion + offset)


def resize(history: History, size: tuple[int, int]) -> History:
    """History for frames of another `size` (H, W): the same field of view at another resolution. Light is interpolated
    bilinearly, geometry and motion are taken from the nearest pixel, and motion and shifts are rescaled to the new
    pixels. Recent frames are left out: their noise would be interpolated."""
    (H, W), (before_H, before_W) = size, history.radiance.shape[2:]
    scale = history.radiance.new_tensor([W / before_W, H / before_H]).reshape(1, 2, 1, 1)

    def resized(name: str, tensor: Tensor) -> Tensor:
        shifts = name == FOUND or name.startswith(SHIFTS)
        cells = (SHIFT_CELL,) if shifts else CELLS  # the shape does not tell it where a picture is smaller than one
        cell = next(c for c in cells if tensor.shape[2:] == (-(-before_H // c), -(-before_W // c)))
        h, w = -(-H // cell), -(-W // cell)
        if name in NEAREST:
            tensor = F.interpolate(tensor, (h, w), mode="nearest-exact")
            return tensor * scale if name == "motion_next" else tensor
        smaller = h < tensor.shape[2] or w < tensor.shape[3]  # torch has no such filter for float16 on a CPU
        between = F.interpolate(tensor.float(), (h, w), mode="bilinear", antialias=smaller).to(tensor.dtype)
        return between * scale if shifts else between

    layers = {name: tensor for name, tensor in history.layers().items() if not name.startswith(RECENT)}
    return History.from_layers({name: resized(name, tensor) for name, tensor in layers.items()})


def save_history(path: Path, history: History | None, **metadata: str) -> None:
    """Write a history, or None for the start of a sequence, to a .safetensors file. A sequence denoised in two sittings
    then equals one denoised in one, to the bit. Raises InputError where the file cannot be written."""
    tensors = history.layers() if history else {}
    write_history(
        path, {name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()}, metadata
    )


def load_history(path: Path, device: str | torch.device = "cpu") -> tuple[History | None, dict[str, str]]:
    """Read a file of `save_history`: the history and its metadata. Raises InputError where the file cannot be read or
    holds something else."""
    stored, metadata = read_history(path)
    if not stored:
        return None, metadata
    try:
        return from_arrays(stored, device), metadata
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def from_arrays(stored: Mapping[str, np.ndarray], device: str | torch.device) -> History:
    """A history from its arrays (`data.stored.read_history`). Raises InputError where they do not form one."""
    if "radiance" not in stored:
        raise InputError(f"not a history of this version: it holds {', '.join(sorted(stored))}")
    try:
        return History.from_layers({name: torch.from_numpy(array).to(device) for name, array in stored.items()})
    except ValueError as error:
        raise InputError(f"{error}; another version wrote it") from None
