"""Fog and smoke. numpy only.

A sample that is scattered in a volume hits nothing: it has neither depth nor normal nor motion, and the albedo of fog.
The one beside it has those of the surface behind. So features are noise, and history is lost in many pixels. But what
is seen through fog is a mixture of both, and moves as the surface does (docs/notes/fog.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import shifted

CELL = 16  # side in pixels of the cells in which scattered light tells of fog; 3×3 count together
LIT, SURELY = 0.1, 0.5  # share of what hits nothing there that is lit by fog: then all of it is; likewise with a sky
REACH = 8  # pixels to the surface that a scattered sample shows, along either axis
FOUR = (0, -1), (0, 1), (-1, 0), (1, 0)  # (y, x)
CORNERS = (-1, -1), (1, 1), (-1, 1), (1, -1)
STEPS = 1, 5  # pixels between the 5×5 pixels over which fog's share is averaged, twice
SAME_DEPTH = 0.05  # relative


@np.errstate(all="ignore")  # broken pixels are compared, and count for nothing
def with_fog(
    frame: Frame,  # numpy arrays of one picture with depth
    scattered: np.ndarray,  # [1, 3, H, W] light of volumes
    sky: np.ndarray | None,  # [1, 3, H, W] light of the background; None: unknown
    few_samples: bool = True,
) -> Frame:
    """The frame with depth, normal and motion of the nearest surface in pixels whose sample is one of fog: that hit
    nothing, is not lit by the background, and lies where fog lights others.

    With `few_samples` all pixels have the albedo of surface and fog together, (1 - f) surface + f fog, with the share f
    of fog among the samples of 25×25 pixels that show the same surface. The frame itself where there is no fog.
    """
    if len(frame.radiance) != 1 or frame.depth is None:
        return frame
    hit = frame.depth[0, 0] > 0
    fog = ~hit & _is_foggy(hit, (scattered[0] > 0).any(0), None if sky is None else (sky[0] > 0).any(0))
    if not fog.any():
        return frame
    source = nearest(hit, fog)
    found = fog & (source >= 0)
    surfaces = filled_from(frame, source, found)
    if frame.albedo is None or not few_samples:
        return surfaces
    behind = _filled(frame.albedo, source, found)
    return replace(surfaces, albedo=_mixed(frame.albedo, behind, surfaces.depth[0, 0], hit, found))


def filled_from(
    frame: Frame,
    source: np.ndarray,  # [H, W] index of a pixel
    found: np.ndarray,  # [H, W] bool
) -> Frame:
    """The frame with depth, normal and motion of their sources in the pixels that are `found`."""
    layers = {name: getattr(frame, name) for name in ("depth", "normal", "motion", "motion_next")}
    filled = {name: _filled(layer, source, found) for name, layer in layers.items() if layer is not None}
    return replace(frame, **filled)


def _filled(layer: np.ndarray, source: np.ndarray, found: np.ndarray) -> np.ndarray:
    layer = layer.copy()
    planes = layer[0].reshape(layer.shape[1], -1)
    planes[:, found.ravel()] = planes[:, source[found]]
    return layer


def _is_foggy(hit: np.ndarray, lit: np.ndarray, sky: np.ndarray | None) -> np.ndarray:
    """Where what hits nothing is fog, `[H, W]`."""
    missed = ~hit if sky is None else ~hit & ~sky
    share = _around(lit & missed) / np.maximum(_around(missed), 1e-6)
    return missed & (share >= (SURELY if sky is None else LIT))


def _around(image: np.ndarray) -> np.ndarray:
    """The mean over the cell of each pixel and the eight around it, `[H, W]`."""
    H, W = image.shape
    edged = np.pad(image.astype(np.float32), [(0, -H % CELL), (0, -W % CELL)])
    cells = edged.reshape(-1, CELL, edged.shape[1] // CELL, CELL).mean((1, 3))
    mean = sum(shifted(cells, [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)], 1)) / 9
    return mean.repeat(CELL, 0).repeat(CELL, 1)[:H, :W]


def nearest(hit: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The index of a surface near each pixel that is wanted, `[H, W]` int32; -1 where there is none within REACH."""
    found = np.where(hit, np.arange(hit.size, dtype=np.int32).reshape(hit.shape), np.int32(-1))
    for _ in range(REACH):
        if not (wanted & (found < 0)).any():
            break
        before = found
        for steps in (FOUR, CORNERS):
            for there in shifted(before, steps, 1):
                found = np.where(wanted & (found < 0), there, found)
    return found


def _mixed(
    albedo: np.ndarray,  # [1, 3, H, W] as rendered
    surface: np.ndarray,  # [1, 3, H, W] of the surface
    depth: np.ndarray,  # [H, W] of the surface
    hit: np.ndarray,  # [H, W] whether the sample is one of it
    fog: np.ndarray,  # [H, W] or of fog before it
) -> np.ndarray:
    """(1 - f) surface + f fog, `[1, 3, H, W]`."""
    known = (hit | fog).astype(np.float32)
    sums = np.concatenate([known[None], fog[None] * np.float32(1), fog * albedo[0]])
    apart = SAME_DEPTH * depth
    for step in STEPS:
        steps = [(step * y, step * x) for y in range(-2, 3) for x in range(-2, 3)]
        total, same, part = np.zeros_like(sums), np.empty_like(depth), np.empty_like(depth)
        for its_depth, *its in shifted(np.concatenate([depth[None], sums]), steps, 2 * step):
            np.abs(np.subtract(its_depth, depth, out=same), out=same)
            np.less_equal(same, apart, out=same, casting="unsafe")
            for plane, added in zip(total, its, strict=True):
                plane += np.multiply(added, same, out=part)
        sums = total
    count, foggy, light = sums[0], sums[1], sums[2:]
    f = foggy / np.maximum(count, 1)
    mixture = (1 - f) * surface[0] + f * light / np.maximum(foggy, 1)
    return np.where((hit | fog) & (foggy > 0), mixture, albedo[0])[None].astype(albedo.dtype)
