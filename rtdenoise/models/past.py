"""What a network that averages light knows of each pixel from the frames before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..constants import OUTDATED_PICTURE, RECALL_BOTH_SIDES
from ..exposure import noise_level
from ..frame import NOTHING_KNOWN, Frame, History, Known, reverse
from ..ops import reproject, warp
from ..ops.agrees import agrees
from ..ops.glow import left_by_glow
from ..ops.keep import keep
from ..ops.off_pixel import off_pixel
from ..ops.outdated import flashed, outdated
from ..ops.passed import passed
from ..ops.pixels import demodulate, joined, modulate
from ..ops.recall import Recalled, recall
from ..ops.relit import gain, relit_
from ..ops.retextured import retextured
from ..ops.scattered import scattered
from ..ops.turned import turned
from ..splat import history_motion

if TYPE_CHECKING:
    from .presets import Config


@dataclass(frozen=True)
class Past:
    """The history of each pixel, reprojected. Zero where there is none."""

    light: Tensor  # [B, 3, H, W] mean of irradiance
    albedo: Tensor  # [B, 3, H, W] running mean of albedo
    length: Tensor  # [B, 1, H, W] frames in the mean of irradiance
    albedo_length: Tensor  # [B, 1, H, W] likewise, but 0 where albedo is: light can reach farther back
    output: Tensor  # [B, 3, H, W] the previous output, reprojected; the noisy radiance where there is none
    on_screen: Tensor  # [B, 1, H, W] bool: motion leads onto the previous frame, and its light is not outdated
    uncovered: Tensor  # [B, 1, H, W] bool: just uncovered by a moving object
    turned: Tensor | None = None  # [B, 1, H, W] share that gives way, as surfaces or textures have moved; None: unknown
    outdated: Tensor | None = None  # [B, 1, H, W] likewise, as light has changed in all recent frames (`ops.outdated`)
    passed: Tensor | None = None  # [B, 1, H, W] bool, likewise: `ops.passed`
    footprint: Tensor | None = None  # [B, 9, H, W] mean of `footprint` in recent frames, where the history keeps any
    footprint_count: Tensor | None = None  # [B, 1, H, W] frames in it
    later: History | None = None  # what the frames after know (`later`)

    @cached_property
    def held(self) -> Tensor:
        """Pixels with a history: where the previous output shows them, `[B, 1, H, W]` bool."""
        return self.on_screen & ~self.uncovered

    @cached_property
    def stays(self) -> Tensor:
        """The share that is not `turned` or `outdated`, `[B, 1, H, W]`; 1 where `uncovered`, as nothing is held."""
        left = torch.ones_like(self.length)
        for share in (self.turned, self.outdated):
            left = left if share is None else left * (1 - share)
        return left.masked_fill(self.uncovered, 1)

    def giving_way(self, weight: Tensor) -> Tensor:
        """A network's weight of the current frame against history, and what is `turned` or `outdated`, `[B, 1, H, W]`
        in [0, 1]."""
        for share in (self.turned, self.outdated):
            weight = weight if share is None else torch.lerp(weight, share.new_ones(()), share)
        return weight


def reprojected(
    config: Config,
    frame: Frame,
    noisy: Tensor,  # [B, 3, H, W] the frame's demodulated light
    history: History | None,
    known: Known = NOTHING_KNOWN,
) -> Past:
    """History, reprojected to this frame: means from the same surface only, the previous output from any. Light is the
    mean of recent frames where `config.recent` keeps any, and of those of `known.ahead`, or else a running mean.
    It is as bright as the frame."""
    if history is not None:
        history = nearest(history, known)
    past = _nothing(frame) if history is None else _before(config, frame, noisy, history, known)
    past = _and_after(past, config, frame, noisy, known) if known.ahead else past
    return past if history is None and not known.ahead else _relit(past, frame, noisy)


def _relit(past: Past, frame: Frame, noisy: Tensor) -> Past:
    """`past` with its light and footprint as bright as this frame, and its previous output as bright as they are: a
    single frame has too few of the rarest bright samples, and would darken it."""
    brighter = gain(past.light, noisy, past.length > 0)
    past = replace(past, light=relit_(past.light, brighter))
    if past.footprint is not None:
        past = replace(past, footprint=relit_(past.footprint, brighter))
    if past.output is frame.radiance:  # there is no previous one
        return past
    if past.footprint is None:
        now, known = modulate(past.light, frame.albedo, frame.albedo, past.length, frame.depth), past.length
    else:
        now, known = past.footprint[:, :3], past.footprint_count
    return replace(past, output=relit_(past.output, gain(past.output, now, past.held & (known > 0))))


def nearest(history: History, known: Known) -> History:
    """`history` with the recent frames that are looked up: with those ahead `RECALL_BOTH_SIDES` at most, but no fewer
    than are ahead. The farthest in time tell least."""
    ahead = len(known.ahead)
    return replace(history, recent=history.recent[: max(ahead, RECALL_BOTH_SIDES - ahead)])


def _nothing(frame: Frame) -> Past:
    """The past of a first frame."""
    nothing = torch.zeros_like(frame.radiance)
    never = torch.zeros_like(nothing[:, :1], dtype=torch.bool)
    return Past(nothing, nothing, nothing[:, :1], nothing[:, :1], frame.radiance, never, never)


def _before(config: Config, frame: Frame, noisy: Tensor, history: History, known: Known) -> Past:
    """What the frames before know."""
    kind = "traditional" if known.covered else config.motion
    motion, seen, uncovered = history_motion(frame, history, kind, known.shift)
    here, before = (frame.depth, frame.normal), (history.depth, history.normal)
    seen_there = None, None
    if config.recent:
        recalled = _recalled(config, frame, noisy, motion, history, uncovered, known)
        light, length, seen_there = recalled.light, recalled.count, (recalled.footprint, recalled.footprint_count)
        surfaces, found = reproject((history.mean_albedo, history.normal), motion, here, before)
        albedo, normal = surfaces.split(3, dim=1)
        albedo_length = length * found
        agree = length if history.recent else torch.ones_like(length)
    else:
        means = history.mean, history.mean_albedo, history.length
        surfaces, found = reproject(means, motion, here, before)
        light, albedo, length = surfaces.split([3, 3, 1], dim=1)
        normal, albedo_length = reproject(history.normal, motion, here, before)[0], length
        agree = agrees(noisy, light, found)
    turn = _turn(frame, albedo, normal, found, known.still)
    old = _outdated(found, agree, history.recent, turn)
    output = history.radiance if known.still else warp(history.radiance, motion, seen, frame.radiance, cubic=True)
    shown = left_by_glow(old < OUTDATED_PICTURE, frame.albedo, history.mean_albedo, motion)
    if known.waits and len(history.recent) > 1:  # in a strobe frames agree, but for those beside
        newest = recall(noisy, motion, here, history.recent[:1]).count
        shown &= (1 - turn) * flashed(found, newest) < OUTDATED_PICTURE
    output, seen = torch.where(shown, output, frame.radiance), seen & shown
    hidden = passed(uncovered, here, before, frame.motion) if config.recent else None
    left = (1 - turn) * albedo_length
    return Past(light, albedo, length, left, output, seen, uncovered, turn, old, hidden, *seen_there)


def _outdated(found: Tensor, agree: Tensor, asked: Sequence, turn: Tensor) -> Tensor:
    """`ops.outdated` by the frames that were `asked`, or a running mean, less where surfaces `turn`: what they reflect
    always changes, and history gives way as far as they turn."""
    return (1 - turn) * outdated(found, agree, max(1, len(asked)))


def _and_after(past: Past, config: Config, frame: Frame, noisy: Tensor, known: Known) -> Past:
    """`past` with the light, and the footprint, of the frames after in its means."""
    after, shift = later(config, frame, known), None if known.shift is None else -known.shift
    motion, _, covered = history_motion(reverse(frame), after, config.motion, shift)
    found = _recalled(config, frame, noisy, motion, after, covered, known)
    light, length = joined(past.light, past.length, found.light, found.count)
    turn = _turned(frame, known.ahead[0], motion) if past.turned is None else past.turned
    old = None if past.outdated is None else _outdated(past.outdated > 0, length, known.ahead, turn)
    past = replace(past, light=light, length=length, later=after, turned=turn, outdated=old)
    seen = found.footprint, found.footprint_count
    if config.footprint and past.footprint is not None:
        seen = joined(past.footprint, past.footprint_count, *seen)
    return replace(past, footprint=seen[0], footprint_count=seen[1])


def later(config: Config, frame: Frame, known: Known) -> History | None:
    """The frames after as a history of the reversed frame, None where there are none: geometry and `recent`. Light
    moves on over its surfaces as it has moved here (`Known.shift`)."""
    if not known.ahead:
        return None
    following, shift = known.ahead[0], None if known.shift is None else -known.shift
    recent = known.coming if shift is None else ()
    if not recent:
        turns = known.turning or tuple(turning(a, b) for a, b in pairwise(known.ahead))
        recent = tuple(coming(config, a, turn, shift) for a, turn in zip(known.ahead, turns, strict=False))
    last = coming(config, known.ahead[-1], torch.zeros_like(frame.depth), shift)  # nothing is beyond it
    return History(following.radiance, following.motion, following.depth, following.normal, recent=(*recent, last))


def coming(config: Config, frame: Frame, turn: Tensor, shift: Tensor | None = None) -> Tensor:
    """A frame ahead as `History.recent` has those before. `turn`: how far it turns to the one after it; `shift`: how
    light moves over its surfaces on the way back."""
    return kept(config, reverse(frame), turn, shift=shift)


def turning(frame: Frame, following: Frame) -> Tensor:
    """How far surfaces turn, or textures move over them, from a frame to the one after it, `[B, 1, H, W]` in [0, 1]; 1
    where something else passes (`ops.passed`)."""
    here, there = (frame.depth, frame.normal), (following.depth, following.normal)
    back = History(following.radiance, following.motion, *there)
    covered = history_motion(reverse(frame), back)[2]
    turn = _turned(frame, following, frame.motion_next)
    return turn.masked_fill(passed(covered, here, there, frame.motion_next), 1)


def _turned(frame: Frame, other: Frame, motion: Tensor) -> Tensor:
    """`_turn` between a frame and the one that motion leads to."""
    here, there = (frame.depth, frame.normal), (other.depth, other.normal)
    seen, found = reproject((other.albedo, other.normal), motion, here, there)
    return _turn(frame, *seen.split(3, dim=1), found)


def _turn(frame: Frame, albedo: Tensor, normal: Tensor, found: Tensor, still: bool = False) -> Tensor:
    """How far history gives way, as surfaces have turned or textures have moved over them, `[B, 1, H, W]`. `albedo` and
    `normal`: those of before, where they were `found`. `still`: no surface moves."""
    texture = retextured(frame.albedo, albedo, found)
    return texture if still else texture + (1 - texture) * turned(frame.normal, normal)


def _recalled(
    config: Config, frame: Frame, noisy: Tensor, motion: Tensor, history: History, uncovered: Tensor, known: Known
) -> Recalled:
    """`recall` of the history's recent frames."""
    surface = frame.depth, frame.normal
    if not config.footprint:
        return recall(noisy, motion, surface, history.recent)
    lone = None if of_many(config) else scattered(frame.depth)  # depth of many samples is a mean: alone at every edge
    return recall(noisy, motion, surface, history.recent, uncovered, misplaced(config, frame, known), lone)


def of_many(config: Config) -> bool:
    """Whether a network with footprints is for many samples a pixel."""
    return getattr(config, "many", False)


def misplaced(config: Config, frame: Frame, known: Known) -> Tensor | None:
    """How much less lookups off the pixel count, `[B, 1, 1, 1]` (`ops.recall`): the less noise, the more. None for a
    network for few samples: one sample shows a place within the pixel that is as far off."""
    if not (config.footprint and getattr(config, "many", True)):
        return None
    noise = noise_level(frame.radiance, frame.depth) if known.noise is None else known.noise
    return off_pixel(noise, frame.more_history)


def kept(
    config: Config, frame: Frame, reset: Tensor, noisy: Tensor | None = None, shift: Tensor | None = None
) -> Tensor:
    """A sanitised frame as `History.recent` has it. `noisy`: its demodulated light, where that is known; `shift`:
    `Known.shift`."""
    if noisy is None:
        noisy = demodulate(frame.radiance, frame.albedo, frame.depth)
    motion = frame.motion if shift is None or frame.motion is None else frame.motion + shift
    return keep(noisy, frame.depth, frame.normal, reset, motion, frame.albedo if config.footprint else None)
