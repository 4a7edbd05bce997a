"""Layers that a frame lacks: constants take their place. Needs no torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data.sequences import Sequence
from ..frame import Frame

# Values that replace a missing layer, the same in every pixel.
STAND_INS = {"albedo": (1.0, 1.0, 1.0), "normal": (0.0, 0.0, 1.0), "depth": (1.0,)}
# Cost of a missing layer on the bundled sequence (python bench/missing_layers.py).
COSTS = {
    "albedo": "textures blur, by about 4 dB of PSNR on the bundled sequence",
    "normal": "edges between surfaces blur, by up to 0.2 dB of PSNR on the bundled sequence",
    "depth": "outlines blur and cuts are not seen, by 0.1 dB of PSNR on the bundled sequence",
    "motion": "each frame is denoised alone and flickers, by about 1.2 dB of PSNR on the bundled sequence",
    "motion_next": "it is approximated from motion and depth, which costs next to nothing on the bundled sequence",
}


def with_stand_ins(frame: Frame) -> Frame:
    """The frame with each missing layer that the networks read replaced by a constant: a numpy array."""
    B, _, H, W = frame.radiance.shape
    return replace(frame, **{
        layer: np.ascontiguousarray(np.broadcast_to(np.float32(value)[:, None, None], (B, len(value), H, W)))
        for layer, value in STAND_INS.items() if getattr(frame, layer) is None
    })  # fmt: skip


def told_of_missing(sequence: Sequence, motion: bool) -> list[str]:
    """What the files lack, what that costs and how to get it, a line a layer. `motion`: whether history needs it."""
    wanted = (*STAND_INS, *(["motion"] if motion and len(sequence) > 1 else []))
    return [
        f"no {layer}: {COSTS[layer]}; {sequence.layout.hint(layer, sequence.signal)}"
        for layer in wanted if not sequence.has(layer)
    ]  # fmt: skip
