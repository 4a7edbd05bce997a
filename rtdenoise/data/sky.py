"""Motion where nothing is hit: Cycles writes none there. numpy only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import OFF_SCREEN, Frame

STANDS = 0.05  # share of the surfaces from which on, without motion, the camera stands still


def without_stale_sky(frame: Frame) -> Frame:
    """A frame of Cycles (numpy arrays) with `OFF_SCREEN` for the motion of misses, so that they have no history, where
    motion is 0 in every one of them though the camera moves: hardly any surface stands still."""
    if frame.depth is None:
        return frame
    misses = frame.depth == 0
    if not misses.any() or misses.all():
        return frame
    layers = {name: getattr(frame, name) for name in ("motion", "motion_next")}
    stale = {name: np.where(misses, np.float32(OFF_SCREEN), motion) for name, motion in layers.items()
             if motion is not None and _stale(motion, misses)}  # fmt: skip
    return replace(frame, **stale) if stale else frame


def _stale(motion: np.ndarray, misses: np.ndarray) -> bool:
    still = (motion == 0).all(1, keepdims=True)
    return bool(still[misses].all() and still[~misses].mean() < STANDS)
