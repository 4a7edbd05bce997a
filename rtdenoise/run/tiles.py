"""A frame in windows: tiles where it is too large for memory, one window where the rest of the frame is plain.

An output pixel depends on input within `config.network_reach` pixels, and on history farther by its motion. A window
that is wider by both on all sides gives the same pixels in its core as the whole frame, up to the rounding of
convolutions over another size, if it is denoised with the statistics of the whole frame (`Denoiser.statistics`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import torch
from torch import Tensor

from ..exposure import noise_level
from ..frame import NOTHING_KNOWN, RECENT, Frame, History, Known
from ..models import Denoiser
from ..models.config import CELL
from ..models.moved_light import followed, shifted
from ..motion import on_screen
from ..ops.kept import motion_of
from ..sanitise import sanitise

GEOMETRY = ("motion_next", "depth", "normal")  # fields that a history copies from its frame
Window = tuple[int, int, int, int]  # top, left, bottom, right


class Tiled:
    """A denoiser that works in tiles, for frames of any size: `step` as the denoiser's.

    Raises ValueError for a model whose outputs depend on the whole frame.
    """

    def __init__(self, denoiser: Denoiser, tile: int = 1024) -> None:
        if denoiser.config.network_reach is None:
            raise ValueError(f"{denoiser.config.architecture}: each output depends on the whole frame; no tiles")
        self.denoiser, self.tile = denoiser, max(CELL, tile // CELL * CELL)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """`[B, 3, H, W]` and the next history, equal to the untiled ones up to rounding."""
        return step_in_windows(self.denoiser, frame, history, known, self.split((0, 0, *frame.size)))

    def split(self, window: Window) -> list[Window]:
        """The tiles of a window."""
        top, left, bottom, right = window
        return [(y, x, min(y + self.tile, bottom), min(x + self.tile, right))
                for y in range(top, bottom, self.tile) for x in range(left, right, self.tile)]  # fmt: skip


def step_in_windows(
    denoiser: Denoiser,
    frame: Frame,
    history: History | None,
    known: Known,
    cores: list[Window],  # the windows to denoise, disjoint
    elsewhere: Tensor | float = 0.0,  # [1, 3, 1, 1] the output outside the windows: one colour
) -> tuple[Tensor, History]:
    """One step, window by window."""
    frame = frame if known.sanitised else sanitise(frame)
    scale, distance = denoiser.statistics(frame)
    noise = noise_level(frame.radiance, frame.depth) if denoiser.config.footprint else None
    known = replace(known, sanitised=True, exposure=scale, distance=distance, noise=noise)
    known = shifted(frame, history, known)
    image = torch.zeros_like(frame.radiance) + elsewhere
    after = {"radiance": image.clone()}
    lengths = _farther(carried(frame, history), carried_ahead(frame, known.ahead))
    if lengths is not None and known.shift is not None:
        lengths = lengths + known.shift.abs()
    before = history and replace(history, found=None, shifts=())
    for core in cores:
        top, left, bottom, right = window = widened(core, lengths, denoiser.config.network_reach, frame.size)
        size = bottom - top, right - left
        within = replace(known, part=True)
        if known.shift is not None:
            within = replace(within, shift=known.shift[..., top:bottom, left:right])
        within = replace(
            within,
            ahead=tuple(other.crop(top, left, *size) for other in known.ahead),
            turning=tuple(share[..., top:bottom, left:right] for share in known.turning),
            coming=tuple(kept[..., top:bottom, left:right] for kept in known.coming),
        )
        part, part_history = denoiser.step(
            frame.crop(top, left, *size), before and _crop_history(before, window, frame.size), within
        )
        _paste(image, part, core, window, frame.size)
        for name, tensor in part_history.layers().items():
            if name not in after:
                h, w = (-(-whole * n // s) for whole, n, s in zip(frame.size, tensor.shape[2:], size, strict=True))
                form = torch.channels_last if name.startswith(RECENT) else torch.contiguous_format
                after[name] = tensor.new_zeros(*tensor.shape[:2], h, w).contiguous(memory_format=form)
            _paste(after[name], tensor, core, window, frame.size)
    after |= {name: tensor for name in GEOMETRY if (tensor := getattr(frame, name)) is not None}
    after = History.from_layers(after)
    if after.noisy is not None:  # a network that follows light
        after = followed(frame, history, after, denoiser.config.recent + 1)
    return image, after


def carried(frame: Frame, history: History | None) -> Tensor | None:
    """Largest distance from which each pixel fetches history, `[1, 2, H, W]` pixels in x and y: motion or dual motion,
    where it leads to the screen, the way on through recent frames, and a margin for lookups between pixels. None
    without history."""
    if history is None:
        return None
    return _lengths(frame.motion, history.motion_next, map(motion_of, history.recent[:-1]))


def carried_ahead(frame: Frame, ahead: tuple[Frame, ...]) -> Tensor | None:
    """`carried` of the frames after."""
    if not ahead:
        return None
    return _lengths(frame.motion_next, ahead[0].motion, (other.motion_next for other in ahead[:-1]))


def _lengths(motion: Tensor, back: Tensor | None, onward: Iterable[Tensor]) -> Tensor:
    """`carried`, for the motion to a neighbour in time, that from there `back`, and those from it to the next ones."""

    def within(motion: Tensor) -> Tensor:
        return torch.where(motion.abs() < max(motion.shape[2:]), motion.abs(), 0.0)

    lengths = torch.where(on_screen(motion), motion.abs(), 0.0)
    # Without `back` it is splatted to the target of motion, and looked up there.
    lengths = 2 * lengths if back is None else lengths.maximum(within(back))
    for other in onward:
        lengths = lengths + within(other).amax((2, 3), keepdim=True) + 1
    return lengths + 5  # lookup between pixels, cracks of the splat


def _farther(a: Tensor | None, b: Tensor | None) -> Tensor | None:
    return a.maximum(b) if a is not None and b is not None else a if b is None else b


def widened(core: Window, lengths: Tensor | None, reach: int, size: tuple[int, int]) -> Window:
    """The window that `core` depends on: wider by `reach`, and by the largest `lengths` in there (`carried`)."""
    wide = _clip((core[0] - reach, core[1] - reach, core[2] + reach, core[3] + reach), *size)
    if lengths is None:
        return wide
    x, y = map(int, lengths[..., wide[0] : wide[2], wide[1] : wide[3]].amax((0, 2, 3)).tolist())
    return _clip((wide[0] - y, wide[1] - x, wide[2] + y, wide[3] + x), *size)


def _clip(window: Window, H: int, W: int) -> Window:
    top, left, bottom, right = window
    top, left = max(0, top) // CELL * CELL, max(0, left) // CELL * CELL
    return top, left, min(H, _up(bottom)), min(W, _up(right))


def _crop_history(history: History, window: Window, size: tuple[int, int]) -> History:
    return History.from_layers({
        name: tensor[(..., *_slices(window, (0, 0), size, tensor.shape[2:]))]
        for name, tensor in history.layers().items()
    })  # fmt: skip


def _paste(whole: Tensor, part: Tensor, core: Window, window: Window, size: tuple[int, int]) -> None:
    """Copy the core of a window's result into the whole; both may be at a lower resolution than the frame."""
    target = _slices(core, (0, 0), size, whole.shape[2:])
    source = _slices(core, window[:2], size, whole.shape[2:])
    whole[(..., *target)] = part[(..., *source)]


def _slices(window: Window, origin: tuple[int, int], size: tuple[int, int], grid: torch.Size) -> tuple[slice, slice]:
    """Rows and columns of a window, relative to `origin`, on a grid that may be coarser than the frame."""

    def along(axis: int) -> slice:
        factor = round(size[axis] / grid[axis]) or 1
        start, stop, first = window[axis], window[axis + 2], origin[axis]
        return slice((start - first) // factor, -(-(stop - first) // factor))

    return along(0), along(1)


def _up(length: int) -> int:
    return -(-length // CELL) * CELL
