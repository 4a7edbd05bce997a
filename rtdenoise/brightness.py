"""How bright the picture is as a whole, against the first frame of its shot: an animated exposure, a fade, lights that
dim together.

History is light of other frames. Where all light changes from frame to frame it is too dark or too bright, by less than
the noise of any pixel, so that nothing there tells. But all pixels together do: over blocks, the light of a frame is
compared with that of an earlier one, looked up along motion on the same surfaces, and the median of the ratios is how
much brighter the picture has become. Frames are denoised divided by that, so that history is as bright as they are,
and denoised pictures are multiplied by it. Networks scale with the exposure, and need not know.

    gain(i) = gain(i - 1) · exp(m)   where |m| > BRIGHTER · σ,    m = median over blocks of log(Σ frame / Σ earlier)

where both frames are divided by their gains, and σ is the standard error of the median. Elsewhere the gain stays, to
the bit; so it does where a quarter of the picture says otherwise: one lamp of several is not all light, however bright.
Where a coloured one shines everywhere, as a sign that blinks, another colour stays. Lamps that dim may turn warmer.
The earlier frame is one, up to `OLDEST` frames old: noise is skewed, so that the median ratio of a frame and a mean of
several is not 1 where light stays, but that of two frames is. A slow change is told once it has grown, if it grows
beyond noise in so many frames. A black frame is compared with nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .color import luminance
from .data.stored import seen_step
from .frame import Frame
from .motion import on_screen, same_surface
from .ops import fetch
from .ops.ranks import median
from .ops.replace_invalid import replace_invalid
from .sanitise import VALID

BLOCK = 16  # pixels, of those that are compared (`data.stored.seen_step`)
LEAST_BLOCKS = 16
BRIGHTER = 3.5  # standard errors
LIKE = 3.0  # standard errors of a quarter's median that may lie between it and that of the whole
APART = 0.35  # likewise whatever its error, a factor of 1.4; half of the change at most
STAYS = 2 / 3  # of the change, by which red, green or blue stays behind where it is not theirs
OLDEST = 6  # frames
LARGEST = 1e15  # gain, and one over the smallest
STANDARD_ERROR = 1.4826 * 1.2533  # of a median, over √n times the median distance from it


@dataclass(frozen=True)
class Brightness:
    """What is known after a frame. Of pictures there is every `seen_step`-th pixel."""

    gain: Tensor  # [B, 1, 1, 1] the frame's brightness over that of the first of its shot
    light: Tensor  # [B, 3, h, w] radiance of an earlier frame, or of this one, divided by its gain
    gains: Tensor  # [B, 1, h, w] that gain
    age: Tensor  # [B, 1, h, w] frames since then, and 1; 0 where there is no light
    depth: Tensor  # [B, 1, h, w]
    normal: Tensor  # [B, 3, h, w]

    @property
    def value(self) -> float:
        """The gain of a single picture."""
        return self.gain.item()

    def of(self, frame: Frame) -> Tensor | np.ndarray:
        """The gain as what the frame's light is: a tensor, or an array."""
        return self.gain if isinstance(frame.radiance, Tensor) else self.gain.cpu().numpy()

    def divided(self, frame: Frame) -> Frame:
        """The frame as it is denoised: on a CPU itself, where that changes nothing."""
        if self.gain.device.type == "cpu" and (self.gain == 1).all():
            return frame
        return frame.divided(self.of(frame))

    def stored(self) -> np.ndarray:
        """All but the gain, `[B, 9, h, w]`."""
        return torch.cat([self.light, self.gains, self.age, self.depth, self.normal], 1).cpu().numpy()

    @classmethod
    def restored(cls, stored: np.ndarray, gain: float, device: str) -> Brightness:
        """The inverse."""
        fields = torch.from_numpy(stored).to(device)
        return cls(fields.new_full((1, 1, 1, 1), gain), *fields.split([3, 1, 1, 1, 3], 1))


@torch.inference_mode()
def followed(frame: Frame, before: Brightness | None) -> Brightness:
    """That of a frame with radiance, depth and normal. `before`: that of the frame before in its shot, None where it is
    the first; then the frame needs motion."""
    light, depth, normal, motion = _seen(frame)
    if before is None:
        ones = torch.ones_like(depth)
        return Brightness(ones[..., :1, :1], light, ones, ones, depth, normal)
    earlier, gains, age = fetch(torch.cat([before.light, before.gains, before.age], 1), motion).split([3, 1, 1], 1)
    found = on_screen(motion) & same_surface(depth, normal, before.depth, before.normal, motion) & (age > 0)
    change = _change(light, before.gain, earlier, gains, found & (depth > 0))
    gain = (before.gain * change).clamp(1 / LARGEST, LARGEST)
    dark, was_dark = (x.amax((1, 2, 3), keepdim=True) <= 0 for x in (light, before.light))
    kept = found & (dark | (age < OLDEST) & ~was_dark)
    new = (~dark).to(light.dtype)  # where a black frame has found nothing there is nothing
    light, gains = torch.where(kept, earlier, light / gain), torch.where(kept, gains, gain)
    return Brightness(gain, light, gains, torch.where(kept, age + 1, new), depth, normal)


def _change(light: Tensor, gain: Tensor, earlier: Tensor, gains: Tensor, found: Tensor) -> Tensor:
    """How much brighter light is than earlier light where that was found, once it is divided by `gain` as that is by
    `gains`, as a whole, `[B, 1, 1, 1]`; 1 where noise hides that, where there is too little to compare, where not all
    four quarters of the picture say so, and where one of its colours stays as it was, undivided."""
    found = found.to(light.dtype)
    compared = light / gain * found, earlier * found, light * found, earlier * gains * found, found
    now, then, shown, shown_then, share = (F.avg_pool2d(x, min(BLOCK, *x.shape[2:])) for x in compared)
    ratios = _ratios(luminance(now), luminance(then), share)
    change, error, blocks = _median(ratios)
    told = (blocks >= LEAST_BLOCKS) & (change.abs() > BRIGHTER * error)
    for quarter in (part for rows in ratios.chunk(2, 2) for part in rows.chunk(2, 3)):
        its, its_error, its_blocks = _median(quarter)
        apart = (its - change).abs() > torch.maximum(LIKE * its_error, (change.abs() / 2).clamp(max=APART))
        told &= ~apart | (its_blocks < LEAST_BLOCKS / 4)
    whole = _median(_ratios(luminance(shown), luminance(shown_then), share))[0]
    for colour in _ratios(shown, shown_then, share).split(1, 1):
        its, its_error, its_blocks = _median(colour)
        stays = (whole - its) * whole.sign() > torch.maximum(LIKE * its_error, STAYS * whole.abs())
        told &= ~stays | (its_blocks < LEAST_BLOCKS)
    return torch.where(told, change, 0).exp()


def _ratios(now: Tensor, then: Tensor, share: Tensor) -> Tensor:
    """log(now / then) of blocks; NaN where either is 0, or the light of less than half of a block was found."""
    return torch.where((share >= 0.5) & (now > 0) & (then > 0), (now / then).log(), torch.nan)


def _median(ratios: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The median of a picture's values that are not NaN, its standard error, and how many they are: `[B, 1, 1, 1]`."""
    ratios = ratios.flatten(1)
    count = (~ratios.isnan()).sum(1).view(-1, 1, 1, 1)
    middle = _middle(ratios)
    return middle, STANDARD_ERROR * _middle((ratios - middle.flatten(1)).abs()) / count.sqrt(), count


def _middle(values: Tensor) -> Tensor:
    """The mean of the lower and the upper median, `[B, N] -> [B, 1, 1, 1]`; NaN where there is nothing else."""
    return (median(values) - median(-values)) / 2


def _seen(frame: Frame) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
    """Radiance, depth, normal and motion of the pixels that are compared, sanitised."""
    step = seen_step(frame.size)
    layers = {name: getattr(frame, name) for name in ("radiance", "depth", "normal", "motion")}
    layers = {
        name: (layer if isinstance(layer, Tensor) else torch.from_numpy(layer))[..., ::step, ::step].contiguous()
        for name, layer in layers.items() if layer is not None
    }  # fmt: skip
    layers = replace_invalid(layers, VALID)
    motion = layers["motion"] / step if "motion" in layers else None
    return layers["radiance"], layers["depth"], layers["normal"], motion
