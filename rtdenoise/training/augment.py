"""Augmentation: random flips, quarter turns, time reversal, tints and channel permutations of a clip, with its motion
vectors; moving light and patterns of shadow where there were none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..frame import Frame

_COLOURS = ("radiance", "components", "albedo", "reference", "reference_half")
_LIGHT = ("radiance", "components", "reference", "reference_half")
_MOTIONS = ("motion", "motion_next")
MAX_RELIGHT = 3.0  # stops between a patch of light and its surroundings, brighter or darker
MAX_SPEED = 8.0  # of the patch, pixels a frame
PERIODS = 4, 64  # of a pattern, pixels
SOFTNESS = 0.5, 8  # of its edges, pixels
MAX_SHADE = 7.0  # stops between its light and its shadow
MAX_TINT = 0.5  # stops by which a colour channel of the light is brightened or darkened


def augment(frames: list[Frame], rng: np.random.Generator, reversible: bool = True) -> list[Frame]:
    """The clip flipped, turned, reversed (if `reversible`), tinted and with permuted colour channels: one draw for all
    its frames.

    In a reversed clip `motion` and `motion_next` change places; numbers and noise stay with their frames. World-space
    normals stay: a mirrored picture shows a mirrored world, in which they are plausible normals too.
    """
    flip_x, flip_y, transposed = rng.random(3) < 0.5
    order = torch.from_numpy(rng.permutation(3))
    backwards = rng.random() < 0.5 and reversible
    tint = torch.from_numpy(2 ** rng.uniform(-MAX_TINT, MAX_TINT, 3)).float().reshape(1, 3, 1, 1)

    def spatial(tensor: Tensor) -> Tensor:
        tensor = tensor.transpose(2, 3) if transposed else tensor
        axes = [axis for axis, flipped in ((3, flip_x), (2, flip_y)) if flipped]
        return tensor.flip(axes) if axes else tensor

    sign = torch.tensor([-1.0 if flip_x else 1.0, -1.0 if flip_y else 1.0]).reshape(1, 2, 1, 1)

    def turned(frame: Frame) -> Frame:
        frame = frame.map(spatial)
        changes = {k: _reordered(t, order) for k in _COLOURS if (t := getattr(frame, k)) is not None}
        changes |= {
            k: (t.flip(1) if transposed else t) * sign for k in _MOTIONS if (t := getattr(frame, k)) is not None
        }
        changes |= {k: changes[k] * tint.repeat(1, changes[k].shape[1] // 3, 1, 1) for k in _LIGHT if k in changes}
        frame = replace(frame, **changes)
        return replace(frame, motion=frame.motion_next, motion_next=frame.motion) if backwards else frame

    turned_frames = [turned(frame) for frame in frames]
    return turned_frames[::-1] if backwards else turned_frames


def _reordered(image: Tensor, order: Tensor) -> Tensor:
    """Each picture of `image` `[B, 3K, H, W]` with its colour channels in another order."""
    return image.unflatten(1, (-1, 3))[:, :, order].flatten(1, 2)


def shade(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    """The clip with a pattern of shadow that no feature shows: stripes as of blinds, a grid as of a window, or spots as
    of leaves.

    Noise and reference are multiplied alike. Rendered sets have few such shadows, and without them a network learns
    that detail is in the features alone: it wipes out the shadow of a blind that 64 samples show clearly. The pattern
    stays where it is on the screen, so this is for single frames and still cameras.
    """
    H, W = frames[0].radiance.shape[2:]
    y, x = torch.meshgrid(torch.linspace(-1, 1, H), torch.linspace(-1, 1, W), indexing="ij")
    period = math.exp(rng.uniform(*np.log(PERIODS)))  # pixels
    nearer = 1 + rng.uniform(-0.4, 0.4) * x + rng.uniform(-0.4, 0.4) * y  # in perspective
    angle, kind = rng.uniform(0, math.pi), rng.integers(3)
    u = (math.cos(angle) * x * W / 2 + math.sin(angle) * y * H / 2) / nearer
    v = (math.cos(angle) * y * H / 2 - math.sin(angle) * x * W / 2) / nearer
    if kind == 2:
        coarse = (1, 1, max(2, round(H / period)), max(2, round(W / period)))
        spots = torch.from_numpy(rng.standard_normal(coarse)).float()
        wave = F.interpolate(spots, (H, W), mode="bicubic", align_corners=False)[0, 0]
    else:
        wave = torch.sin(2 * math.pi * u / period + rng.uniform(0, 7))
        if kind == 1:
            wave = torch.minimum(wave, torch.sin(2 * math.pi * v / period + rng.uniform(0, 7)))
    steep = period / (2 * math.pi) / math.exp(rng.uniform(*np.log(SOFTNESS)))
    lit = torch.sigmoid(4 * steep * (wave - rng.uniform(-0.5, 0.5)))
    factor = 1 - (1 - 2.0 ** -rng.uniform(1, MAX_SHADE)) * lit
    return [replace(f, **{k: t * factor for k in _LIGHT if (t := getattr(f, k)) is not None}) for f in frames]


def relight(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    """The clip with a round patch of brighter or darker light, hard or soft, that crosses the picture and may appear on
    the way.

    Noise and reference are multiplied alike, so the reference stays the mean of the noise. No feature shows this light,
    as none shows the shadow of an object off the screen: only the noise says that the running mean is out of date.
    """
    H, W = frames[0].radiance.shape[2:]
    x, y = torch.arange(W).float(), torch.arange(H).float()[:, None]
    (left, top), velocity = rng.random(2) * (W, H), rng.uniform(-MAX_SPEED, MAX_SPEED, 2)
    radius, softness = rng.uniform(0.1, 0.6) * min(H, W), 2 ** rng.uniform(-1, 4)
    stops, switched = rng.uniform(-MAX_RELIGHT, MAX_RELIGHT), rng.random() < 0.5
    first, middle = int(rng.integers(1, len(frames))) if switched and len(frames) > 1 else 0, (len(frames) - 1) / 2

    relit = []
    for i, frame in enumerate(frames):
        if i >= first:
            u, v = x - (left + velocity[0] * (i - middle)), y - (top + velocity[1] * (i - middle))
            inside = torch.sigmoid((radius - torch.hypot(u, v)) / softness)
            factor = 2 ** (stops * inside)
            frame = replace(frame, **{k: t * factor for k in _LIGHT if (t := getattr(frame, k)) is not None})
        relit.append(frame)
    return relit
