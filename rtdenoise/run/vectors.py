"""What do the numbers of a motion field mean? Fitted, by warping one frame to the next.

A field f stands for the motion (aₓ (f₀ − o), a_y (f₁ − o)), or with f₀ and f₁ swapped. Of all pixels with texture the
same few are compared for every reading, moving or not. A grid of factors comes first, then smaller and smaller steps;
a factor that fits as well as a usual unit becomes that unit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import log2

import torch
from torch import Tensor

from ..data.layout import SCALES, pixels
from ..frame import Frame
from .conventions import MIN_CONTRAST, MIN_PIXELS, STANDARD_ERRORS, contrast, feature_of, sample, standard_error, tiles

Factors = tuple[float, float]  # of x and y
POINTS = 3000  # pixels of each pair of frames
UNKNOWN = 1e9  # vectors as long are none
GREY = 0.5  # may stand for no motion
OFTEN = 0.05  # share of pixels with exactly one value: what stands for no motion, or the end of a range
STEPS = tuple(2.0 ** (k / 2) for k in range(-6, 27))  # factors that are tried, of pixels
SHARES = tuple(2.0 ** (k / 2) for k in range(-5, 6))  # and of the picture's size
FINEST = 1 / 64  # step of a factor, as a power of two
ALIKE, LOST = 0.1, 0.08  # most difference to a usual unit, as a power of two, or share of an axis' worth that it loses
ENOUGH = 0.97  # least share that a usual unit explains
NOTHING = 0.005  # share of what is explained that an axis without movement changes
LEAST = 0.05  # share of the error that motion explains at least


@dataclass(frozen=True)
class Meaning:
    """How a field is to be read. `scale` is that of `layout.Rule`."""

    offset: float = 0.0
    swapped: bool = False
    signs: tuple[int, int] = (1, 1)
    scale: float | str = 1.0
    error: float = float("inf")  # as a share of that without motion
    told: str = ""
    confirmed: bool = False


@dataclass(frozen=True)
class _Points:
    """Pixels of pairs of frames."""

    images: list[Tensor]  # the previous frame of each pair
    of: list[tuple[Tensor, Tensor, Tensor, Tensor]]  # x, y, colours [C, N] and field [2, N] of each
    size: tuple[int, int]

    def errors(self, offset: float, swapped: bool, factors: Tensor) -> Tensor:
        """[R, N] errors of readings with `factors` [R, 2]."""
        found = []
        for image, (x, y, colours, field) in zip(self.images, self.of, strict=True):
            a, b = (field.flip(0) if swapped else field) - offset
            at = sample(image, x + factors[:, :1] * a, y + factors[:, 1:] * b)
            found.append((at - colours).abs().mean(1))
        return torch.cat(found, 1)

    @property
    def tiles(self) -> Tensor:
        """[N] the tile of a pair that a pixel belongs to."""
        return torch.cat([tiles(i, y.long(), x.long(), self.size) for i, (x, y, *_) in enumerate(self.of)])


def fit(pairs: list[tuple[Frame, Frame]], fields: list[Tensor]) -> Meaning:
    """How `fields`, `[1, 2, H, W]` of the second frame of each pair, lead to the first."""
    stored = torch.cat([field[0].flatten(1) for field in fields], 1) if fields else torch.zeros(2, 0)
    stored = stored[:, (stored.abs() < UNKNOWN).all(0)]
    if said_nothing := _useless(stored):
        return said_nothing
    points = next((p for name in ("albedo", "radiance") if (p := _points(pairs, fields, name))), None)
    if points is None:
        return Meaning(offset=_offsets(stored)[0], told="too little has texture")
    best, *others = (_fitted(points, offset) for offset in _offsets(stored))
    for other in others:  # with another offset a field is nearly a shift of the whole picture: pixels alone count
        if other.confirmed and other.scale == 1 and other.error < best.error * (1 - LEAST):
            best = other
    return best


def _useless(stored: Tensor) -> Meaning | None:
    """What is told of `[2, N]` vectors that cannot be read; None where they may be."""
    if not stored.numel():
        return Meaning(told="no two consecutive frames have any")
    if (stored == stored[:, :1]).all():
        return Meaning(told=f"it is ({stored[0, 0] + 0.0:g}, {stored[1, 0] + 0.0:g}) everywhere: was motion blur on?")
    for middle in (0.0, GREY):
        lengths = torch.linalg.vector_norm((stored - middle) / (1 - middle), dim=0)
        moving = lengths[lengths > 0]
        if len(moving) and ((moving - 1).abs() < 0.02).float().mean() > 0.9:
            return Meaning(middle, told="all vectors have one length: directions alone; render raw vectors")
    moved = stored[:, (stored != 0).any(0)]
    ends = ((moved == 0) | (moved == 1)).any(0).float().mean()
    if (moved >= 0).all() and (moved <= 1).all() and (moved == 1).any() and ends > OFTEN:
        return Meaning(GREY, told=f"{ends:.0%} of it ends at 0 or 1: clamped; render without")
    return None


def _offsets(stored: Tensor) -> tuple[float, ...]:
    """What may stand for no motion in `[2, N]` vectors, likelier first."""
    some = stored[:, :: max(1, stored.shape[1] // 100_000)].float()
    low, middle, high = torch.quantile(some, torch.tensor([0.01, 0.5, 0.99]), dim=1)
    centred = ((middle - GREY).abs() < GREY / 2).all()
    still = (stored == 0).all(0).float().mean() > OFTEN
    grey = ((stored - GREY).abs() < 1e-3).all(0).float().mean() > OFTEN
    if grey or (centred and (low >= 0).all() and (high <= 1).all()):
        return (GREY, 0.0) if still else (GREY,)
    return (0.0,) if still else (0.0, GREY)


def _points(pairs: list[tuple[Frame, Frame]], fields: list[Tensor], name: str) -> _Points | None:
    """Pixels with texture; None where there are too few, or a frame lacks the feature."""
    images, found = [], []
    for (previous, current), field in zip(pairs, fields, strict=True):
        here, before = feature_of(current, name), feature_of(previous, name)
        if here is None or before is None:
            return None
        y, x = ((contrast(here) > MIN_CONTRAST) & (field[0].abs() < UNKNOWN).all(0)).nonzero(as_tuple=True)
        chosen = torch.randperm(len(x), generator=torch.Generator().manual_seed(0))[:POINTS]
        y, x = y[chosen], x[chosen]
        images.append(before)
        found.append((x.float(), y.float(), here[0, :, y, x], field[0, :, y, x].float()))
    points = _Points(images, found, pairs[0][1].size)
    return points if sum(len(x) for x, *_ in found) >= MIN_PIXELS else None


@dataclass(frozen=True)
class _Readings:
    """The errors of one offset and order of the components, beyond twice those without motion cut off: there something
    was uncovered, or is off the screen."""

    points: _Points
    offset: float
    swapped: bool

    @cached_property
    def still(self) -> Tensor:
        """[N], without motion."""
        return self.points.errors(0.0, False, torch.zeros(1, 2))[0]

    def each(self, factors: list[Factors]) -> Tensor:
        """[R, N]"""
        errors = self.points.errors(self.offset, self.swapped, torch.tensor(factors))
        return errors.clamp(max=2 * self.still.mean())

    def mean(self, factors: list[Factors]) -> Tensor:
        """[R]"""
        return self.each(factors).mean(1)

    def explains(self, factors: Factors, best: Factors) -> float:
        """How much less error than without motion there is, as a share of what `best` does."""
        mine, least = self.mean([factors, best])
        return ((self.still.mean() - mine) / (self.still.mean() - least)).item()


def _fitted(points: _Points, offset: float) -> Meaning:
    """The best reading with this offset."""
    grid, orders = list(_grid(points.size)), [_Readings(points, offset, swapped) for swapped in (False, True)]
    errors = [readings.mean(grid) for readings in orders]
    swapped = bool(errors[1].min() < errors[0].min() * (1 - LEAST / 2))
    readings = orders[swapped]
    best = _refined(grid[int(errors[swapped].argmin())], readings.mean)
    gain = readings.still - readings.each([best])[0]
    error = 1 - (gain.mean() / readings.still.mean()).item()
    if gain.mean() < max(LEAST * readings.still.mean(), STANDARD_ERRORS * standard_error(gain, points.tiles)):
        return Meaning(offset, told="it explains no change of the pictures")
    signs, scale, told = _in_units(readings, best)
    if scale is None:
        return Meaning(offset, swapped, signs, 1.0, error, told)
    share = f"measured: {1 - error:.0%} of what changes between frames is explained by it"
    return Meaning(offset, swapped, signs, scale, error, share + told, confirmed=True)


def _in_units(readings: _Readings, best: Factors) -> tuple[tuple[int, int], float | str | None, str]:
    """Signs, the scale of a rule, None where there is none, and what is to be told."""
    without = (0.0, best[1]), (best[0], 0.0)
    flat = [axis for axis in (0, 1) if readings.explains(without[axis], best) > 1 - NOTHING]
    signs = tuple(1 if axis in flat or factor > 0 else -1 for axis, factor in enumerate(best))
    told = f", though nothing moves along {'xy'[flat[0]]}: its sign and unit are not" if flat else ""
    for scale, unit in _usual(readings.points.size).items():
        unit = signs[0] * unit[0], signs[1] * unit[1]
        alone = (unit[0], best[1]), (best[0], unit[1])
        fits = (
            axis in flat or abs(log2(unit[axis] / best[axis])) < ALIKE
            or 1 - readings.explains(alone[axis], best) < LOST * (1 - readings.explains(without[axis], best))
            for axis in (0, 1)
        )
        if all(fits) and readings.explains(unit, best) > ENOUGH:
            return signs, scale, told
    x, y = (abs(best[1 - axis if axis in flat else axis]) for axis in (0, 1))
    if abs(log2(x / y)) < 3 * ALIKE:
        return signs, float(f"{(x * y) ** 0.5:.3g}"), f"{told}; scale is fitted, some percent off: put in what you know"
    return signs, None, f"({best[0]:.4g}·x, {best[1]:.4g}·y) fits, which is no unit"


def _grid(size: tuple[int, int]) -> Iterator[Factors]:
    H, W = size
    for x, y in product((1, -1), repeat=2):
        yield from ((x * k, y * k) for k in STEPS)
        yield from ((x * k * W, y * k * H) for k in SHARES)


def _usual(size: tuple[int, int]) -> dict[float | str, Factors]:
    """Scale of a rule -> factors of x and y."""
    return {scale: pixels(scale, size) for scale in (1.0, *SCALES, 2.0, 0.5)}


def _refined(factors: Factors, mean: Callable[[list[Factors]], Tensor]) -> Factors:
    """The factors around which no smaller step is better."""
    step, least = 0.25, mean([factors])[0]
    while step >= FINEST:
        steps = product((-step, 0.0, step), repeat=2)
        around = [(factors[0] * 2**a, factors[1] * 2**b) for a, b in steps]
        errors = mean(around)
        if errors.min() < least:
            factors, least = around[int(errors.argmin())], errors.min()
        else:
            step /= 2
    return factors

