"""Motion that is zero everywhere though the picture changes, as Blender 4 writes it with motion blur, or only that to
the next frame, motion of another convention, vectors without the motion of the lens, surfaces that are others in each
frame, albedo that tells nothing, and noise that stands still. Needs no torch, but for convention and lens."""

from __future__ import annotations

import math
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from ..frame import Frame
from ..sanitise import FAR
from .same_noise import SAME_NOISE, has_same_noise

if TYPE_CHECKING:
    from .conventions import Verdict
    from .lens import Drift

# A pixel has changed where its value lies outside those around it in the frame before by more than a share of the value
# (depth), or by an amount (albedo). Such pixels of Cycles at 1 sample: up to 0.1 % of a still scene with depth of
# field, 1 to 4 % where things move by a pixel or two.
DEPTH_CHANGE, ALBEDO_CHANGE, LEAST = 0.02, 0.05, 0.005
MOST = 100_000  # about so many pixels of a frame are looked at
BLURRED = "was motion blur on? render without it, or name a second render without it by --surfaces"
UNMOVED = f"motion is zero everywhere though the picture changes ({{}}), so what moves leaves trails: {BLURRED}"
ALONE = (
    f"motion is zero everywhere though the picture changes, so most frames are denoised alone: {BLURRED} "
    "(before a still camera it may be things without vectors: --no-detect-cuts)"
)
PAIRS, PIXELS = 2, 4000  # pairs of frames whose motion vectors, and noise, are judged, and pixels of each
WRONG = "motion: looks like {}; as it is, history comes from wrong places (`rtdenoise inspect` tells more)"
LACKS = (
    "the picture {} against its motion vectors, so history blurs: an animated focal length or camera shift, which "
    "Cycles' vectors lack? `denoise --lens` adds it"
)
MOST_CUTS = 0.5  # of the frames: more are no cuts
CUTS = (
    "most frames find other surfaces than the one before: fog, depth of field or thin things before a moving camera, "
    "or wrong depth; each is denoised alone (try --no-detect-cuts)"
)
STOPPED = (
    "motion_next is zero everywhere though motion is not, which is worse than none: leave it out, as the layout that "
    "`rtdenoise inspect SEQ --write my.toml` writes"
)
FLAT = "albedo is the same in all pixels of {}, so textures blur: was its pass forgotten?"


def is_unmoved(before: Frame, now: Frame) -> bool:
    """Whether the motion of a frame is zero in every pixel, while depth or albedo tell that things have moved. What
    has no surface, as smoke before nothing, has no motion either: its albedo does not count."""
    if now.motion is None or np.asarray(now.motion).any():
        return False
    solid = np.array(True) if now.depth is None else _valid(np.asarray(now.depth)) > 0
    layers = (
        (before.depth, now.depth, DEPTH_CHANGE, 0.0, np.array(True)),
        (before.albedo, now.albedo, 0.0, ALBEDO_CHANGE, solid),
    )
    return any(
        old is not None and new is not None and _changed(np.asarray(old), np.asarray(new), *bounds) > LEAST
        for old, new, *bounds in layers
    )


class Stops:
    """Whether `motion_next` is zero in all frames so far that move, of two or more."""

    def __init__(self) -> None:
        self._moving, self._stopped = 0, 0  # frames

    def see(self, frame: Frame) -> None:
        """The next frame as it was read."""
        if self._stopped == self._moving and frame.motion is not None and np.asarray(frame.motion).any():
            self._moving += 1
            self._stopped += frame.motion_next is not None and not np.asarray(frame.motion_next).any()

    @property
    def found(self) -> bool:
        """A movement may end in one frame."""
        return self._stopped == self._moving > 1


class Flatness:
    """Whether albedo is the same in all pixels of all frames so far."""

    def __init__(self) -> None:
        self._albedo: np.ndarray | None = None  # of the first pixel
        self._flat = True

    def see(self, frame: Frame) -> None:
        """The next frame as it was read."""
        if self._flat and frame.albedo is not None:
            albedo = np.asarray(frame.albedo)
            self._albedo = albedo[..., :1, :1] if self._albedo is None else self._albedo
            self._flat = bool((albedo == self._albedo).all())

    @property
    def found(self) -> bool:
        """False where there is no albedo."""
        return self._flat and self._albedo is not None


class Watch:
    """Notes each once in a run."""

    def __init__(self, notes: list[str]) -> None:
        """`notes`: those that an interrupted run has made of the frames before, to add to."""
        self._notes, self._before = notes, None
        self._told = any(note.startswith(UNMOVED.partition("{")[0]) for note in notes)
        self._seen = 0  # frames
        self._verdicts: list[Verdict] = []  # of the first pairs that move
        self._drifts: list[Drift | None] = []  # likewise, and of the first pairs with motion 0 that have any
        self._still = 0  # how many pairs with motion 0 have been asked for theirs
        self._moves: bool | None = None  # whether any pixel of any frame does; None before the first one
        self._albedo, self._next = Flatness(), Stops()
        self._same: list[bool] = []  # whether noise is the same, likewise
        self._last: Frame | None = None  # while that is asked

    def see(self, frame: Frame, goes_on: bool) -> None:
        """The next frame as it was read; `goes_on`: with the shot of the last one."""
        self._seen += 1
        self._albedo.see(frame)
        self._next.see(frame)
        self._compare_noise(frame)
        moves = frame.motion is not None and bool(np.asarray(frame.motion).any())
        self._moves = self._moves or moves
        judges = (len(self._verdicts) if moves else self._still) < PAIRS and find_spec("torch") is not None
        if frame.motion is None or (self._told and not judges):
            return
        if self._before is not None:
            # Wrong motion may look like a cut.
            if judges and frame.number == self._before.number + 1:
                self._judge(frame, moves)
            if goes_on and not (self._told or any(self._drifts)) and is_unmoved(self._before, frame):
                self._notes.append(UNMOVED.format(f"frame {frame.number}"))
                self._told = True
        self._before = frame

    def end(self, frames: int, cuts: int) -> None:
        """After the last one of so many frames, of which so many began anew for what they showed. A run that went on
        has not seen all: then nothing is said that is not true of all of them."""
        whole = self._seen == frames
        if cuts > MOST_CUTS * frames and (whole or self._moves):
            self._notes.append(CUTS if self._moves else ALONE)
        if whole and self._albedo.found:
            self._notes.append(FLAT.format("all frames"))
        if whole and self._next.found:
            self._notes.append(STOPPED)

    def _compare_noise(self, frame: Frame) -> None:
        """Note it where all pairs have the same noise."""
        last, self._last = self._last, frame if len(self._same) < PAIRS else None
        if last is not None and frame.number == last.number + 1:
            self._same.append(has_same_noise(last, frame))
            if self._same == [True] * PAIRS:
                self._notes.append(SAME_NOISE.format("every frame"))

    def _judge(self, frame: Frame, moves: bool) -> None:
        """Note it where all pairs say that the motion is wrong, and in the same way, or that it lacks something."""
        import torch

        from .conventions import check_motion
        from .lens import find_drift

        first, second = (x.map(torch.as_tensor) for x in (self._before, frame))
        drift = find_drift(first, second)
        if moves:
            self._verdicts.append(check_motion([(first, second)], PIXELS))
        if moves or drift:
            self._drifts.append(drift)
        self._still += not moves
        wrong = [verdict.best for verdict in self._verdicts if verdict.status == "wrong"]
        if len(wrong) == PAIRS and len(set(wrong)) == 1:
            self._notes.append(WRONG.format(wrong[0]))
        elif len(self._drifts) == PAIRS and all(self._drifts) and not self._told_of_lens():
            self._notes.append(str(self._drifts[0]))

    def _told_of_lens(self) -> bool:
        return any(note.endswith(LACKS.partition("{}")[2]) for note in self._notes)


def _changed(before: np.ndarray, now: np.ndarray, relative: float, absolute: float, counts: np.ndarray) -> float:
    """Share of the pixels of `[1, C, H, W]` that have changed and count, `[1, 1, H, W]` bool."""
    if np.array_equal(before, now):
        return 0.0
    H, W = now.shape[2:]
    step = max(1, math.isqrt(H * W // MOST))
    padded = np.pad(before, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    around = [_valid(padded[..., i : i + H : step, j : j + W : step]) for i in range(3) for j in range(3)]
    low, high, now = np.minimum.reduce(around), np.maximum.reduce(around), _valid(now[..., ::step, ::step])
    outside = (now < low * (1 - relative) - absolute) | (now > high * (1 + relative) + absolute)
    return float((outside.any(1) & np.broadcast_to(counts, (1, 1, H, W))[:, 0, ::step, ::step]).mean())


def _valid(x: np.ndarray) -> np.ndarray:
    return np.nan_to_num(x, nan=0.0, posinf=FAR).clip(0, FAR)
