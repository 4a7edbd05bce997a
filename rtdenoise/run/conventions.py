"""Find the convention of motion vectors: warp the previous frame with every likely reading and compare.

The right one of the `readings` makes the previous frame look like the current one:

    error(reading) = mean over textured, moving pixels p of min(|cur(p) - prev(p + m_reading(p))|, cap)

Two readings are compared where they point to different pixels. One is clearly better when the mean difference of the
errors there exceeds both 3 standard errors (tiles of the picture, in several pairs of frames, are the independent
samples) and 2 % of the error itself. Otherwise they are tied; if they hardly differ anywhere they are the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..frame import OFF_SCREEN, Frame
from .readings import DOUBLE, HALF, READINGS, Reading

MIN_MOTION = 0.25  # pixels: least motion of a compared pixel, and least difference between readings there
MIN_CONTRAST = 0.02  # least difference between neighbours at a textured pixel, of a feature in [0, 1]
MIN_PIXELS = 200  # textured, moving pixels that a verdict needs
MAX_SAMPLES = 20_000  # pixels that are examined in each pair of frames
TILES = 8  # along each side of the picture; errors inside one tile count as dependent
STANDARD_ERRORS, MARGIN = 3.0, 0.02  # least lead of a better reading: in standard errors, and as a share of the error


@dataclass(frozen=True)
class Verdict:
    """The result of the check."""

    status: str  # "ok", "wrong" or "ambiguous"
    message: str  # one line
    best: Reading | None = None  # the reading that fits; None where nothing could be compared
    tied: tuple[Reading, ...] = ()  # further readings that fit as well
    errors: dict[str, float] | None = None  # "declared", "best", "no motion" -> error in [0, 1]
    feature: str = ""  # the layer that was compared
    pixels: int = 0  # textured, moving pixels that were compared


@dataclass(frozen=True)
class _Samples:
    """Errors at the sampled pixels of every pair."""

    errors: Tensor  # [R + 1, N] of every reading and, last, of no motion
    groups: Tensor  # [N] tile of a pair that a pixel belongs to
    motions: Tensor  # [R + 1, N, 2] pixels


def check_motion(pairs: Iterable[tuple[Frame, Frame]], most: int = MAX_SAMPLES) -> Verdict:
    """Judge whether `motion` of the second frame of each pair (previous, current) follows the convention of `frame.py`.

    Compares albedo; where that does not settle it, the reference; then the noisy radiance. Frames must have `motion`.
    `most`: pixels that are examined in each pair.
    """
    pairs = list(pairs)
    verdicts = []
    for feature in ("albedo", "reference", "radiance"):
        if samples := _collect(pairs, feature, most):
            verdicts.append(_judge(samples, feature))
            if verdicts[-1].status != "ambiguous":
                return verdicts[-1]
    return verdicts[0] if verdicts else Verdict("ambiguous", "there are no two consecutive frames to compare")


def _collect(pairs: list[tuple[Frame, Frame]], feature: str, most: int) -> _Samples | None:
    """Errors of all readings on up to `most` pixels of each pair; None where a frame lacks the feature."""
    readings = [r for r in READINGS if all(getattr(current, r.source) is not None for _, current in pairs)]
    errors, groups, motions = [], [], []
    for index, (previous, current) in enumerate(pairs):
        here, before = feature_of(current, feature), feature_of(previous, feature)
        if here is None or before is None:
            return None
        y, x = _choose_pixels(here, current, most)
        names = {r.source for r in readings}
        sources = {name: getattr(current, name)[0, :, y, x].T.nan_to_num(0, 0, 0) for name in names}
        fields = torch.stack([r.apply(sources[r.source], current.size) for r in readings] + [torch.zeros(len(x), 2)])
        errors.append((here[0, :, y, x] - sample(before, x + fields[..., 0], y + fields[..., 1])).abs().mean(1))
        groups.append(tiles(index, y, x, current.size))
        motions.append(fields)
    if not errors:
        return None
    return _Samples(torch.cat(errors, 1), torch.cat(groups), torch.cat(motions, 1))


def feature_of(frame: Frame, name: str) -> Tensor | None:
    """An image `[1, 3, H, W]` in [0, 1] in which corresponding pixels look alike.

    It is blurred, because at one sample a pixel features are noisy too: with the same jitter in every frame their noise
    stays in place, which favours no motion; otherwise interpolation averages it, which favours any motion.
    """
    image = getattr(frame, name)
    if image is None:
        return None
    image = torch.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).clamp(min=0)
    if name != "albedo":
        image = image / (image + image.median().clamp(min=1e-6))
    for _ in range(2):
        image = F.avg_pool2d(image, 5, stride=1, padding=2, count_include_pad=False)
    return image


def textured(image: Tensor, frame: Frame) -> Tensor:
    """The pixels `[H, W]` whose motion is known and around which the image has texture."""
    return (contrast(image) > MIN_CONTRAST) & (frame.motion[0].abs() < OFF_SCREEN).all(0)


def contrast(image: Tensor) -> Tensor:
    """The difference between neighbours, `[H, W]`, of an image `[1, C, H, W]`."""
    texture = torch.zeros(image.shape[2:])
    texture[:, 1:-1] += (image[0, :, :, 2:] - image[0, :, :, :-2]).abs().amax(0) / 2
    texture[1:-1] += (image[0, :, 2:] - image[0, :, :-2]).abs().amax(0) / 2
    return texture


def _choose_pixels(image: Tensor, frame: Frame, most: int) -> tuple[Tensor, Tensor]:
    """(y, x) of pixels with texture that move, the same for every reading."""
    has_texture, length = textured(image, frame), torch.hypot(*frame.motion[0])
    moving = has_texture & (length > MIN_MOTION)
    if moving.sum() < 0.05 * (has_texture & (length > 0)).sum():  # the unit may not be pixels
        moving = has_texture & (length * max(frame.size) > MIN_MOTION)
    y, x = moving.nonzero(as_tuple=True)
    order = torch.randperm(len(x), generator=torch.Generator().manual_seed(0))[:most]
    return y[order], x[order]


def sample(image: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Bilinear lookup as `ops.warp` does it, at points `[R, N]` only (pixel (0, 0) is at 0); gives `[R, C, N]`."""
    H, W = image.shape[2:]
    grid = torch.stack([(2 * x + 1) / W - 1, (2 * y + 1) / H - 1], -1)
    return F.grid_sample(image, grid[None], padding_mode="border", align_corners=False)[0].transpose(0, 1)


def _judge(samples: _Samples, feature: str) -> Verdict:
    """Compare the declared reading with the best one."""
    if (count := samples.groups.numel()) < MIN_PIXELS:
        message = f"too little moves: {count} textured pixels move more than {MIN_MOTION} px, {MIN_PIXELS} are needed"
        return Verdict("ambiguous", message, feature=feature, pixels=count)
    # Errors beyond twice the mean error without motion are outliers (uncovered, off-screen).
    samples = replace(samples, errors=samples.errors.clamp(max=2 * samples.errors[-1].mean()))
    mean = samples.errors.mean(1)
    readings = READINGS[: len(mean) - 1]
    best = int(mean[:-1].argmin())
    values = {"declared": mean[0].item(), "best": mean[best].item(), "no motion": mean[-1].item()}
    shared = {"errors": values, "feature": feature, "pixels": count}
    if _compare(samples, best, len(readings)) != "better":
        message = f"no reading of the motion explains how {feature} changes any better than no motion at all"
        return Verdict("ambiguous", message, **shared)

    fitting = [i for i in range(len(readings)) if i == best or _compare(samples, best, i) != "better"]
    fitting.sort(key=lambda i: readings[i].changes)
    nearest, *others = fitting
    tied = tuple(readings[i] for i in others)
    same = f"; not to be told apart here: {', '.join(r.formula for r in tied)}" if tied else ""
    if nearest != 0:
        message = (
            f"looks like {readings[nearest]}; error {values['best']:.4f}, as declared {values['declared']:.4f}{same}"
        )
        return Verdict("wrong", message, readings[nearest], tied, **shared)
    # -motion_next differs from motion only by acceleration, and motion of a pixel from its half by as little: a tie
    # with them leaves no doubt about the convention.
    alike = [i for i in others if readings[i].source != "motion" or readings[i] in (DOUBLE, HALF)]
    rivals = [i for i in others if i not in alike and _compare(samples, 0, i) != "same"]
    if rivals:
        message = f"as declared fits, but as well does: {' | '.join(str(readings[i]) for i in rivals)}"
        return Verdict("ambiguous", message, readings[0], tied, **shared)
    message = f"{readings[0]}; error {values['declared']:.4f}, without motion {values['no motion']:.4f}{same}"
    return Verdict("ok", message, readings[0], tied, **shared)


def _compare(samples: _Samples, a: int, b: int) -> str:
    """Reading a against b, where they differ: "better" (clearly), "same" (they differ almost nowhere) or "tied"."""
    apart = torch.linalg.vector_norm(samples.motions[a] - samples.motions[b], dim=-1) > MIN_MOTION
    if apart.sum() < max(MIN_PIXELS, 0.01 * len(apart)):
        return "same"
    error = samples.errors[a, apart]
    gain = samples.errors[b, apart] - error
    least = max(STANDARD_ERRORS * standard_error(gain, samples.groups[apart]), MARGIN * error.mean())
    return "better" if gain.mean() > least else "tied"


def tiles(index: int, y: Tensor, x: Tensor, size: tuple[int, int]) -> Tensor:
    """[N] the tile of a pair of frames, the one of this index, that a pixel belongs to."""
    H, W = size
    return (index * TILES + y * TILES // H) * TILES + x * TILES // W


def standard_error(values: Tensor, groups: Tensor) -> Tensor | float:
    """Of the mean of `values` [N], which depend on each other within a tile. As of a ratio estimator: tiles weigh by
    their number of pixels. One tile alone proves nothing."""
    count = torch.bincount(groups)
    residual = torch.bincount(groups, values) - values.mean() * count
    full = (count > 0).sum()
    return (residual.square().sum() * full / (full - 1)).sqrt() / len(values) if full > 1 else torch.inf
