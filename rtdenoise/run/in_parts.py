"""Light in parts (`denoise --lights`, `--also`, shadows in alpha): what reads it, denoises it, and writes it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..data.light import LightPasses, find_light
from ..data.light_output import write_light
from ..data.output import write_frame
from ..data.sequences import Sequence
from ..errors import INSTALL_TORCH, InputError
from ..frame import Frame
from .backends import Backend
from .light import PICTURE, LightBackend
from .offline_picture import Picture
from .options import Options, of_output
from .shadows import SHADOWS, Shadows
from .torch_backend import TorchBackend


def in_parts(
    sequence: Sequence,
    options: Options,
    backend: Backend,
    picture: Picture | None = None,
    shadows: Shadows | None = None,
) -> tuple[Backend, Any, Any]:
    """A backend for light in parts around `backend`, and the functions that read its frames and write its results.
    `picture`: instead of that which `backend` makes of the whole. `shadows`: alpha is one of the parts.

    Raises InputError for options that do not go together, and as `find_light`.
    """
    told = "--lights" if options.lights else "--also"
    if options.signal != "color":
        raise InputError(f"{told}: goes with --signal color, not {options.signal}")
    if options.keep and (options.lights or options.also):
        raise InputError(f"{told}: goes without --keep; --layout source passes every channel on")
    if options.lights and options.layout != "source":
        raise InputError(f"--lights: goes with --layout source, which has a place for every pass, not {options.layout}")
    passes = find_light(sequence, options.lights, options.also)
    if not isinstance(backend, TorchBackend):
        raise InputError(f"{told}: goes with --backend torch; {INSTALL_TORCH}")
    if shadows:
        passes = replace(passes, alpha=shadows.rules)
    lit = LightBackend(backend, passes, told, picture, sequence.soft_edges, options.detect_exposure, shadows)
    return lit, lit.read, partial(_write, passes=passes, options=options)


def _write(
    out: Path, sequence: Sequence, index: int, frame: Frame, image: dict[str, np.ndarray],
    passes: LightPasses, options: Options,
) -> dict[str, int]:  # fmt: skip
    parts = {name: part for name, part in image.items() if name not in (PICTURE, SHADOWS)}
    coverage = (1 - image[SHADOWS][0].mean(0)).clip(0, 1) if SHADOWS in image else None
    if not (options.lights or options.also):
        return write_frame(out, sequence, index, frame, image[PICTURE], coverage=coverage, **of_output(options))
    chosen = {name: getattr(options, name) for name in ("layout", "float32", "alpha")}
    return write_light(out, sequence, index, passes, image[PICTURE], parts, coverage=coverage, **chosen)
