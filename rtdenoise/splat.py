"""`motion_next` of the previous frame, approximated where a file has backward motion only.

The current frame knows where its surfaces were: the surface at p was at p + motion(p). Read backwards, the surface
that was at y = p + motion(p) moves by -motion(p). Several pixels may point at one y: a moving object, and the
background that it has just uncovered. y showed one of them, and the depth of the previous frame tells which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .constants import DEPTH_TOLERANCE, MAX_CRACK_DISTANCE
from .frame import OFF_SCREEN, Frame, History
from .motion import OCCLUSION_THRESHOLD, dual_motion, occlusion_mask, on_screen
from .ops import fetch
from .ops.dispatch import Fused, Support, falls_back

VECTORS = Support(channels={"motion": (2,), "motion_next": (2,), "shift": (2,)})
FUSED = Fused("history_motion", native=VECTORS)
WHOLE = Fused("history_motion", triton=VECTORS)  # of every kind, with the shift
NOTHING = torch.iinfo(torch.int64).max  # key of a pixel that nothing lands on


@falls_back
def history_motion(
    frame: Frame, history: History, kind: str = "dual", shift: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """The motion that fetches a frame's history, `[B, 2, H, W]`: dual inside uncovered regions, traditional elsewhere.
    And two masks, `[B, 1, H, W]` bool: whether it leads onto the screen, and whether the pixel is uncovered.

    `shift`, `[B, 2, H, W]`, belongs to traditional motion (`shift.light`). With the `kind` 'traditional' no pixel
    counts as uncovered. A history without `motion_next` gets it by `splat_motion_next`.
    """
    motion_next = None
    if kind != "traditional":
        motion_next = history.motion_next
        if motion_next is None:
            motion_next = splat_motion_next(frame.motion, frame.depth, history.depth)
    if run := WHOLE(motion=frame.motion, motion_next=motion_next, shift=shift):
        return run(frame.motion, motion_next, OCCLUSION_THRESHOLD, shift)
    motion, seen, uncovered = traditional(frame) if motion_next is None else _dual(frame.motion, motion_next)
    if shift is not None:
        motion = torch.where(uncovered, motion, motion + shift)
        seen = on_screen(motion)
    return motion, seen, uncovered


def _dual(motion: Tensor, motion_next: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`history_motion` by dual motion, without a shift."""
    if run := FUSED(motion=motion, motion_next=motion_next):
        return run(motion, motion_next, OCCLUSION_THRESHOLD)
    dual = dual_motion(motion, motion_next)
    uncovered = occlusion_mask(dual, motion)
    motion = torch.where(uncovered, dual, motion)
    return motion, on_screen(motion), uncovered


def traditional(frame: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """`history_motion` where no pixel is uncovered."""
    return frame.motion, on_screen(frame.motion), torch.zeros_like(frame.depth, dtype=torch.bool)


def completed(frame: Frame, following: Frame | None = None) -> Frame:
    """A frame with `motion_next`: where it has none, an approximate one from the next frame of the shot
    (`splat_motion_next`), None at its end."""
    if frame.motion_next is not None or following is None:
        return frame
    return replace(frame, motion_next=splat_motion_next(following.motion, following.depth, frame.depth))


def completed_shot(frames: Sequence[Frame]) -> list[Frame]:
    """All frames of a shot, `completed`."""
    return [completed(*pair) for pair in zip(frames, [*frames[1:], None], strict=True)]


def splat_motion_next(
    motion: Tensor,  # [B, 2, H, W] previous - current, of the current frame
    depth: Tensor,  # [B, 1, H, W] of the current frame; 0 or inf: nothing hit
    depth_previous: Tensor,  # [B, 1, H, W] of the previous frame
    tolerance: float = DEPTH_TOLERANCE,
) -> Tensor:  # [B, 2, H, W] next - current, of the previous frame, approximate
    """Depth-tested forward splat of `motion` onto the previous frame's pixels.

        out(y) = -motion(p*),    p* = argmin { |depth(p) - depth_previous(y)| / max : p + motion(p) rounds to y }

    A surface that grows on the screen covers all its old pixels. One that shrinks or turns leaves cracks, where only
    the surface behind it lands. So where the best p is deeper or nearer than `depth_previous` by more than `tolerance`,
    out(y) is taken from the closest pixel of the same old surface, at most `MAX_CRACK_DISTANCE` away, that received its
    own motion. Without such a pixel (the surface has left the screen or is covered) out(y) = -motion(p*), which makes
    dual motion traditional. A pixel on which nothing lands is now covered: it gets `OFF_SCREEN`, and `dual_motion`
    never looks there.

    Rounds as `ops.fetch` does; the same on every run and device. Not differentiable. Raises ValueError where the shapes
    do not fit.
    """
    B, _, H, W = motion.shape
    for name, tensor in (("depth", depth), ("depth_previous", depth_previous)):
        if tuple(tensor.shape) != (B, 1, H, W):
            raise ValueError(f"expected {name} {(B, 1, H, W)}, got {tuple(tensor.shape)}")
    now, before = _distance(depth), _distance(depth_previous)

    # Every pixel p bids for its target with (mismatch of depth, index of p); the smallest bid wins.
    index = torch.arange(H * W, device=motion.device).reshape(1, 1, H, W).expand(B, 1, H, W)
    bits = _mismatch(now, fetch(before, motion)).view(torch.int32).long()  # floats ≥ 0 are ordered as their bits are
    bid = torch.where(on_screen(motion), bits << 32 | index, NOTHING)
    target = fetch(index, motion)
    best = torch.full((B, H * W), NOTHING, device=motion.device)
    best.scatter_reduce_(1, target.flatten(1), bid.flatten(1), "amin")
    landed = (best != NOTHING).reshape(B, 1, H, W)
    source = torch.where(landed.flatten(1), best & 0xFFFFFFFF, 0)

    def of_source(image: Tensor) -> Tensor:
        C = image.shape[1]
        return image.flatten(2).gather(2, source[:, None].expand(B, C, H * W)).reshape(B, C, H, W)

    out = torch.where(landed, -of_source(motion), OFF_SCREEN)
    fits = landed & (_mismatch(of_source(now), before) <= tolerance)
    return _close_cracks(out, before, fits, landed & ~fits, tolerance)


def _close_cracks(out: Tensor, before: Tensor, fits: Tensor, crack: Tensor, tolerance: float) -> Tensor:
    """Give pixels of `crack` the value of the closest pixel of the same surface that `fits`."""
    H, W = before.shape[2:]
    far = MAX_CRACK_DISTANCE
    steps = range(-far, far + 1)
    offsets = [(dy, dx) for dy in steps for dx in steps if dy or dx]
    pad = [far] * 4
    values = torch.nn.functional.pad(out, pad)
    surface = torch.nn.functional.pad(torch.where(fits, before, torch.nan), pad, value=torch.nan)  # NaN fits nothing
    for dy, dx in sorted(offsets, key=lambda o: o[0] ** 2 + o[1] ** 2):
        window = (..., slice(far + dy, far + dy + H), slice(far + dx, far + dx + W))
        take = crack & (_mismatch(surface[window], before) <= tolerance)
        out = torch.where(take, values[window], out)
        crack = crack & ~take
    return out


def _distance(depth: Tensor) -> Tensor:
    """Depth in float32 with inf where nothing was hit."""
    return torch.where((depth > 0) & depth.isfinite(), depth.float(), torch.inf)


def _mismatch(a: Tensor, b: Tensor) -> Tensor:
    """Relative difference of two distances, in [0, 1]: 0 for two misses, 1 for a hit and a miss; NaN stays NaN."""
    ratio = torch.minimum(a, b) / torch.maximum(a, b)
    return torch.where(a == b, 0.0, 1 - ratio)
