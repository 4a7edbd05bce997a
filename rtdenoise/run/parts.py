"""The light of a frame in parts, and whether they add up to the picture (`light`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.light import LightPasses
from ..errors import InputError
from ..frame import Frame

if TYPE_CHECKING:
    from torch import Tensor

MAX_NEGATIVE = 0.1  # of the light in a layer of `--also`; filters of some renderers have lobes below 0
MAX_APART = 0.02  # of the mean radiance; half floats round by less than 0.001
BACKGROUND = "Environment"  # with a transparent film Cycles leaves it out of Combined


@dataclass(frozen=True)
class Parts:
    """The light of a frame in parts, `[1, 3, H, W]` by name."""

    lights: dict[str, Tensor]  # radiance, sanitised, each to be denoised as a picture
    albedo: dict[str, Tensor]  # sanitised, of the lights that have one of their own
    passed: dict[str, Tensor]  # without noise
    complete: bool = True  # whether they add up to the picture
    background: bool = True  # whether it is in the picture
    groups: tuple[str, ...] = ()  # the light groups, where they add up to the picture

    def lit(self, frame: Frame, name: str) -> Frame:
        """The frame as one light shows it."""
        return replace(frame, radiance=self.lights[name], albedo=self.albedo.get(name, frame.albedo))


def compare_sum(
    name: str, picture: np.ndarray, summands: dict[str, np.ndarray], passes: LightPasses, must: bool
) -> tuple[bool, bool]:
    """Whether the passes add up to the noisy picture, and whether they come nearer to it with the background than
    without. Raises InputError where they do not and `must`."""
    total = sum_of(summands.values())
    mean = max(float(picture.mean()), 1e-12)
    whole, bare = (float(np.abs(x - picture).mean()) / mean for x in (total, total - summands[BACKGROUND]))
    apart = min(whole, bare)
    if must and apart > MAX_APART:
        advice = "" if passes.volumes else "are there volumes? switch on View Layer > Passes > Light > Volume, or "
        raise InputError(f"{name}: --lights: the light passes do not add up to the picture, {100 * apart:.0f} % "
                         f"is missing or too much; {advice}leave --lights out")  # fmt: skip
    return apart <= MAX_APART, whole <= bare


def check_sign(frame: str, name: str, image: np.ndarray) -> None:
    """Raise InputError for a layer that is no light: much of it is negative."""
    finite = np.nan_to_num(image, nan=0, posinf=0, neginf=0).astype(np.float64)  # sums of float32 overflow
    if (share := float(-finite.clip(max=0).sum() / max(np.abs(finite).sum(), 1e-30))) > MAX_NEGATIVE:
        raise InputError(f"{frame}: --also {name}: {100 * share:.0f} % of it is negative, and light never is: leave it "
                         "out")  # fmt: skip


def whole_groups(picture: np.ndarray, groups: dict[str, np.ndarray]) -> tuple[str, ...]:
    """The light groups, if they add up to the picture; else none."""
    apart = np.abs(sum_of(groups.values()) - picture).mean() if groups else np.inf
    return tuple(groups) if apart <= MAX_APART * picture.mean() else ()


def shared_out(picture: Tensor, groups: dict[str, Tensor]) -> dict[str, Tensor]:
    """The groups, scaled so that they add up to the picture: the sum of denoised pictures is not quite the whole."""
    import torch

    total = sum(groups.values())
    return {name: torch.where(total > 0, x / total, 1 / len(groups)) * picture for name, x in groups.items()}


def valid(image: np.ndarray) -> np.ndarray:
    """Finite and not negative."""
    return np.nan_to_num(image, nan=0, posinf=0, neginf=0).clip(0)


def sum_of(images: Iterable[Any]) -> Any:
    first, *others = images
    return sum(others, first)
