"""Layers that a frame lacks: constants take their place. Needs no torch."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike

import numpy as np

from ..data.layouts import MITSUBA, NATIVE
from ..data.names import guess_beside, guess_channels
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
DESCRIBES = "rtdenoise inspect SEQ --write my.toml describes them"


def with_stand_ins(frame: Frame) -> Frame:
    """The frame with each missing layer that the networks read replaced by a constant: a numpy array."""
    B, _, H, W = frame.radiance.shape
    return replace(frame, **{
        layer: np.ascontiguousarray(np.broadcast_to(np.float32(value)[:, None, None], (B, len(value), H, W)))
        for layer, value in STAND_INS.items() if getattr(frame, layer) is None
    })  # fmt: skip


def told_of_missing(sequence: Sequence, motion: bool, source: str) -> list[str]:
    """What the files lack, what that costs and how to get it, a line a layer. `motion`: whether history needs it;
    `source`: what the sequence was opened by."""
    wanted = (*STAND_INS, *(["motion"] if motion and len(sequence) > 1 else []))
    absent = [layer for layer in wanted if not sequence.has(layer)]
    called, beside = held_otherwise(sequence, source) if absent else ((), ())
    ways = {
        **{layer: sequence.layout.hint(layer, sequence.signal) for layer in absent},
        **dict.fromkeys(beside, f"files beside seem to hold it: {DESCRIBES}"),
        **dict.fromkeys(called, f"the files seem to call it otherwise: {DESCRIBES}"),
    }
    return [f"no {layer}: {COSTS[layer]}; {ways[layer]}" for layer in absent]


def held_otherwise(sequence: Sequence, source: str | PathLike) -> tuple[set[str], set[str]]:
    """The layers that files without a program's layout seem to hold by other names, and those that files beside seem to
    hold where the source is a glob."""
    if sequence.layout not in (NATIVE, MITSUBA):
        return set(), set()
    return set(guess_channels(sequence.header.channels)), guess_beside(source)
