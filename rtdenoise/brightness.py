"""How bright the picture is as a whole, against the first frame of its shot: an animated exposure, a fade, lights that
dim together.

History is light of other frames. Where all light changes from frame to frame it is too dark or too bright, by less than
the noise of any pixel, so that nothing there tells. But all pixels together do: over blocks, the light of a frame is
compared with the mean of those before, looked up along motion on the same surfaces, and the median of the ratios is how
much brighter the picture has become. Frames are denoised divided by that, so that history is as bright as they are,
and denoised pictures are multiplied by it. Networks scale with the exposure, and need not know.

    gain(i) = gain(i - 1) · exp(m)   where |m| > BRIGHTER · σ,    m = median over blocks of log(Σ frame / Σ mean)

where Σ frame is of a frame divided by gain(i - 1), and σ is the standard error of the median. Elsewhere the gain stays,
to the bit. What is too small to be told from noise is told once it has grown, since the mean lags behind. Black frames
leave the mean as it is.
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

BLOCK = 16  # pixels, of those that are compared (`data.stored.seen_step`)
LEAST_BLOCKS = 16
BRIGHTER = 3.0  # standard errors
LONGEST = 6  # frames in the mean, at most
LARGEST = 1e15  # gain, and one over the smallest
STANDARD_ERROR = 1.4826 * 1.2533  # of a median, over √n times the median distance from it


@dataclass(frozen=True)
class Brightness:
    """What is known after a frame. Of pictures there is every `seen_step`-th pixel."""

    gain: Tensor  # [B, 1, 1, 1] the frame's brightness over that of the first of its shot
    light: Tensor  # [B, 1, h, w] mean luminance, of frames divided by their gain
    count: Tensor  # [B, 1, h, w] frames in it
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
        """The frame as it is denoised."""
        return frame.divided(self.of(frame))

    def stored(self) -> np.ndarray:
        """All but the gain, `[B, 6, h, w]`."""
        return torch.cat([self.light, self.count, self.depth, self.normal], 1).cpu().numpy()

    @classmethod
    def restored(cls, stored: np.ndarray, gain: float, device: str) -> Brightness:
        """The inverse."""
        fields = torch.from_numpy(stored).to(device)
        return cls(fields.new_full((1, 1, 1, 1), gain), *fields.split([1, 1, 1, 3], 1))


@torch.inference_mode()
def followed(frame: Frame, before: Brightness | None) -> Brightness:
    """That of a frame with radiance, depth and normal. `before`: that of the frame before in its shot, None where it is
    the first; then the frame needs motion."""
    step = seen_step(frame.size)
    light, depth, normal = (_seen(x, step) for x in (frame.radiance, frame.depth, frame.normal))
    light = luminance(light)
    if before is None:
        return Brightness(light.new_ones(len(light), 1, 1, 1), light, torch.ones_like(light), depth, normal)
    motion = _seen(frame.motion, step) / step
    mean, count = fetch(torch.cat([before.light, before.count], 1), motion).split(1, 1)
    found = on_screen(motion) & same_surface(depth, normal, before.depth, before.normal, motion)
    light = light / before.gain
    change, compared = _change(light, mean, found & (depth > 0))
    gain = (before.gain * change).clamp(1 / LARGEST, LARGEST)
    light, count = light / (gain / before.gain), torch.where(found, count, 0).clamp(max=LONGEST - 1)
    averaged = torch.where(compared, (mean * count + light) / (count + 1), torch.maximum(mean * found, light))
    return Brightness(gain, averaged, count + 1, depth, normal)


def _change(light: Tensor, mean: Tensor, found: Tensor) -> tuple[Tensor, Tensor]:
    """How much brighter light is than its mean where that was found, as a whole, 1 where noise hides that; and whether
    there was enough of either to compare: both `[B, 1, 1, 1]`."""
    found = found.to(light.dtype)
    now, before, share = (F.avg_pool2d(x, min(BLOCK, *x.shape[2:])).flatten(1) for x in
                          (light * found, mean * found, found))  # fmt: skip
    known = (share >= 0.5) & (now > 0) & (before > 0)
    ratios = torch.where(known, (now / before).log(), torch.nan)
    middle = ratios.nanmedian(1, keepdim=True).values
    blocks = known.sum(1, keepdim=True)
    error = STANDARD_ERROR * (ratios - middle).abs().nanmedian(1, keepdim=True).values / blocks.sqrt()
    compared = blocks >= LEAST_BLOCKS
    told = compared & (middle.abs() > BRIGHTER * error)
    change = torch.where(told, middle, 0).exp()
    return change[..., None, None], compared[..., None, None]


def _seen(layer: Tensor, step: int) -> Tensor:
    """Every `step`-th pixel, without values that are not finite."""
    return torch.nan_to_num(torch.as_tensor(layer)[..., ::step, ::step], nan=0.0, posinf=0.0, neginf=0.0).float()
