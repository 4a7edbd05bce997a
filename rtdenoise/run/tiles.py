"""A frame in windows: tiles where it is too large for the memory, one window where light is even around it.

What a pixel of the output depends on ends somewhere: `network_reach` pixels away for what the network sees, further by
the motion for what is fetched from history. A window that is wider by that on all sides gives the same pixels in its
core as the whole frame, up to the rounding of convolutions over another size, if the statistics of the whole frame
(`model.statistics`) go with it.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import fields, replace

import torch
from torch import Tensor, nn

from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..motion import on_screen
from ..sanitise import sanitise

CELL = 32  # windows start at multiples of it: the pyramid's pixels must lie as they do in the whole frame
GEOMETRY = ("motion_next", "depth", "normal")  # what a history takes over from the frame as it is
Window = tuple[int, int, int, int]  # top, left, bottom, right


def network_reach(denoiser: nn.Module) -> int:
    """Pixels from which anything can influence an output, rounded up to `CELL`.

    Found, not computed: in a copy whose weights are all positive and whose biases are zero, what one value of the first
    convolution lights up is what depends on it. What the kernels add, which the network chooses, is `light_reach`.
    """
    copy, width, furthest = deepcopy(denoiser).float(), 1024, 0
    convolutions = [module for module in copy.modules() if isinstance(module, nn.Conv2d | nn.ConvTranspose2d)]
    for offset in (0, CELL - 1):  # in a cell, what is pooled reaches further to one side
        column, extents = width // 2 + offset, []

        def light(_module, _inputs, output: Tensor, column: int = column) -> Tensor:
            output = torch.zeros_like(output)
            output[..., column * output.shape[-1] // width] = 1e30  # it thins out on its way, but not to nothing
            return output

        def watch(_module, _inputs, output: Tensor, column: int = column, extents: list = extents) -> None:
            lit = (output != 0).any(dim=2).any(dim=1)[0].nonzero().flatten() * width / output.shape[-1]
            extents.append(int((lit - column).abs().max()) + width // output.shape[-1])

        hooks = [convolutions[0].register_forward_hook(light)]
        hooks += [convolution.register_forward_hook(watch) for convolution in convolutions[1:]]
        with torch.no_grad():
            for convolution in convolutions:
                convolution.weight.fill_(1 / convolution.weight[0].numel())
                convolution.bias.zero_()
            copy.step(_blank(copy, CELL, width))
        for hook in hooks:
            hook.remove()
        furthest = max(furthest, *extents)
    return _up(furthest + 2) + light_reach(denoiser)  # 2: the first convolution's own


@torch.inference_mode()
def keeps_only_the_image(denoiser: nn.Module) -> bool:
    """Whether a history holds the last image and its geometry and nothing else, so that plain rows stay plain."""
    return denoiser.step(_blank(denoiser, CELL, CELL))[1].layers().keys() <= {"radiance", *GEOMETRY}


@torch.inference_mode()
def light_reach(denoiser: nn.Module) -> int:
    """Pixels to which light can be spread from one pixel of a frame or a history, rounded up to `CELL`; farther away a
    black neighbourhood stays black. Found by lighting single pixels: no weight of a softmax is zero."""
    furthest = 0
    for column in (256, 256 + CELL - 1):
        lit, dark = _blank(denoiser, CELL, 512), _blank(denoiser, CELL, 512)
        lit.radiance[..., CELL // 2, column] = 1.0
        _, history = denoiser.step(lit)
        for image in (denoiser.step(lit)[0], denoiser.step(dark, replace(history, radiance=lit.radiance))[0]):
            touched = (image > 0).any(dim=1).any(dim=1)[0].nonzero()
            furthest = max(furthest, int((touched - column).abs().max()))
    return _up(furthest)


class Tiled:
    """A denoiser that works in tiles, for frames of any size: `step` as the denoiser's."""

    def __init__(self, denoiser: nn.Module, tile: int = 1024) -> None:
        self.denoiser, self.tile = denoiser, max(CELL, tile // CELL * CELL)
        self.reach = network_reach(denoiser)

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """`[B, 3, H, W]` and the next history, equal to the untiled ones up to rounding."""
        return step_in_windows(self.denoiser, frame, history, known, self.split((0, 0, *frame.size)), self.reach)

    def split(self, window: Window) -> list[Window]:
        """The tiles of a window."""
        top, left, bottom, right = window
        return [(y, x, min(y + self.tile, bottom), min(x + self.tile, right))
                for y in range(top, bottom, self.tile) for x in range(left, right, self.tile)]  # fmt: skip


def step_in_windows(
    denoiser: nn.Module,
    frame: Frame,
    history: History | None,
    known: Known,
    cores: list[Window],  # the windows to denoise, disjoint
    reach: int,  # `network_reach` of the denoiser
    elsewhere: Tensor | float = 0.0,  # [1, 3, 1, 1] what comes out where there is no window: light of one colour
) -> tuple[Tensor, History]:
    """One step, window by window."""
    frame = frame if known.sanitised else sanitise(frame)
    scale, distance = denoiser.statistics(frame)
    known = replace(known, sanitised=True, exposure=scale, distance=distance)
    image = torch.zeros_like(frame.radiance) + elsewhere
    after = {"radiance": image.clone()}
    lengths = carried(frame, history)
    for core in cores:
        top, left, bottom, right = window = widened(core, lengths, reach, frame.size)
        size = bottom - top, right - left
        part, part_history = denoiser.step(
            frame.crop(top, left, *size), history and _crop_history(history, window, frame.size), known
        )
        _paste(image, part, core, window, frame.size)
        for name, tensor in part_history.layers().items():
            if name not in after:
                h, w = (-(-whole * n // s) for whole, n, s in zip(frame.size, tensor.shape[2:], size, strict=True))
                after[name] = tensor.new_zeros(*tensor.shape[:2], h, w)
            _paste(after[name], tensor, core, window, frame.size)
    after |= {name: tensor for name in GEOMETRY if (tensor := getattr(frame, name)) is not None}
    return image, History(**{f.name: after.get(f.name) for f in fields(History)})


def carried(frame: Frame, history: History | None) -> Tensor | None:
    """How far history is fetched from at most, `[1, 2, H, W]` pixels in x and y: as far as motion leads, or dual
    motion, where either leads to the screen, and what lies between pixels. None without history."""
    if history is None:
        return None
    lengths = torch.where(on_screen(frame.motion), frame.motion.abs(), 0.0)
    if history.motion_next is None:  # splatted from motion, to where motion leads, and looked up there
        lengths = 2 * lengths
    else:
        dual = history.motion_next.abs()
        lengths = lengths.maximum(torch.where(dual < max(frame.size), dual, 0.0))
    return lengths + 5  # lookup between pixels, cracks of the splat


def widened(core: Window, lengths: Tensor | None, reach: int, size: tuple[int, int]) -> Window:
    """The window that `core` depends on: by `reach`, and by the longest way in there that history is `carried`."""
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
    return replace(history, **{
        name: tensor[(..., *_slices(window, (0, 0), size, tensor.shape[2:]))]
        for name, tensor in history.layers().items()
    })  # fmt: skip


def _paste(whole: Tensor, part: Tensor, core: Window, window: Window, size: tuple[int, int]) -> None:
    """Copy the core out of what a window gave; both may be at a lower resolution than the frame."""
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


def _blank(denoiser: nn.Module, H: int, W: int) -> Frame:
    """A frame of a still, evenly lit wall without light."""

    def flat(channels: int, value: float) -> Tensor:
        return torch.full((1, channels, H, W), value, device=next(denoiser.parameters()).device)

    return Frame(flat(3, 0.0), albedo=flat(3, 0.5), normal=flat(3, 0.5), depth=flat(1, 1.0), motion=flat(2, 0.0),
                 motion_next=flat(2, 0.0))  # fmt: skip


def _up(length: int) -> int:
    return -(-length // CELL) * CELL
