"""Shadows that lie in alpha: where they fall on a shadow catcher before a transparent film.

A renderer shows a catcher by alpha alone, over black: each sample has the share of the light that is kept from it. So
this alpha is as noisy as light, at any number of samples. It is denoised as light: what it lets through, 1 − alpha, is
the picture of a white ground in the shadows. Of few samples kernels alone make the best of it; of many the network that
makes the picture does (docs/notes/alpha.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data.around import EIGHT, shifted
from ..data.layout import Rule
from ..data.sequences import Sequence
from ..frame import Frame
from .backends import Backend
from .choice import KERNELS, as_rendered
from .following import Following
from .options import CombineOptions, Options
from .torch_backend import TorchBackend

SHADOWS = "shadows in alpha"  # what the light is called
EVERY = 16  # frames from one that is examined to the next
LEAST = 1e-3  # share of the frame that a catcher covers, lit and in shadow
LIT, DEEP = 0.01, 0.99  # alpha below and above which a catcher's pixel has no shadow, or nothing else
TOLD = "alpha: shadows on a shadow catcher, denoised as light by {}"
LEFT = "alpha: shadows on a shadow catcher stay as noisy as rendered; {} leaves them out"


@dataclass(frozen=True)
class Shadows:
    """The light that alpha holds, and what denoises it."""

    rules: dict[str, Rule]  # SHADOWS -> alpha three times
    backend: Following


def find_shadows(sequence: Sequence, options: Options | CombineOptions) -> str:
    """The channel of an alpha that holds shadows, in one of the frames 0, EVERY, 2 EVERY and so on; "" if none does, or
    it stays as rendered by `options`."""
    channel = sequence.layout.alpha(sequence.header)
    whole = all({*frame.files} == {""} for frame in sequence.files)  # one file has all layers
    beauty = sequence.signal == "color" and not sequence.demodulated
    if not (channel and whole and beauty and options.alpha == "auto" and sequence.has("depth")):
        return ""
    rendered = as_rendered(sequence).only({"radiance", "depth"})
    for i in range(0, len(sequence), EVERY):
        alpha = sequence.planes(i, [channel])[channel]
        if ((alpha > LIT) & (alpha < DEEP)).mean() > LEAST and are_shadows(alpha, rendered.read(i)):
            return channel
    return ""


def are_shadows(
    alpha: np.ndarray,  # [H, W]
    frame: Frame,  # with radiance and depth
) -> bool:
    """Whether alpha holds shadows: black pixels, on surfaces and not at their edges, of alpha 0 and between 0 and 1."""
    hit = np.asarray(frame.depth)[0, 0] > 0
    black = ~np.asarray(frame.radiance)[0].any(0)
    ground = black & np.logical_and.reduce([hit, *shifted(hit, EIGHT, 1)])
    lit, shaded = ground & (alpha < LIT), ground & (alpha > LIT) & (alpha < DEEP)
    return bool(min(lit.mean(), shaded.mean()) > LEAST)


def open_shadows(channel: str, options: Options, backend: Backend) -> tuple[Shadows | None, list[str]]:
    """What denoises the shadows in a channel of alpha beside `backend`, and what to tell; None where it cannot."""
    if not channel:
        return None, []
    averages = isinstance(backend, TorchBackend) and "mean" in backend.config.carries and not backend.config.reads
    if options.correct or not averages:
        return None, [LEFT.format("--correct" if options.correct else f"model {options.model}")]
    model = str(options.model) if str(options.model).endswith("many") else KERNELS[0]
    ran = backend.ran
    kernels = TorchBackend(model, ran["device"], options.precision, lookahead=options.lookahead)
    rule = Rule((channel,) * 3, (1, 1, 1))
    return Shadows({SHADOWS: rule}, Following(kernels, follows=False)), [TOLD.format(model)]
