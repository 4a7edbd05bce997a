"""Samples of what is less than half opaque. numpy only.

Cycles writes normal and motion of the first surface whose alpha is half or more (the view layer's Alpha Threshold), and
depth of the last one that was met by then. So a sample that a veil, or the rim of a leaf cut out by alpha, has turned
back has depth, and neither normal nor motion. Its history would be lost, or of what lies elsewhere. But what is seen is
a mixture, which moves as the surface does that the samples around show; and its albedo, which is little in a pane that
lets most of them through, would be a dark dot (docs/notes/fog.md).
"""

from __future__ import annotations

import numpy as np

from ..frame import Frame
from .fog import filled_from, nearest
from .lost import with_mean_albedo


def with_veiled(frame: Frame) -> Frame:
    """A frame of Cycles (numpy arrays) with depth, normal and motion of the nearest surface, and albedo of the samples
    around it, in pixels that hit one without normal and motion. Those that are far from all surfaces stay, but for
    their albedo. The frame itself where there are none."""
    layers = [layer for layer in (frame.normal, frame.motion, frame.motion_next) if layer is not None]
    if len(frame.radiance) != 1 or frame.depth is None or frame.normal is None or len(layers) == 1:
        return frame
    hit = frame.depth[0, 0] > 0
    veiled = hit & ~np.logical_or.reduce([layer[0].any(0) for layer in layers])
    if not veiled.any() or veiled.all():
        return frame
    source = nearest(hit & ~veiled, veiled)
    found = filled_from(frame, source, veiled & (source >= 0))
    return found if frame.albedo is None else with_mean_albedo(found, veiled)
