"""A frame whose light was denoised in parts, as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from .exr import write_layers, write_like
from .light import LightPasses
from .output import PLAIN, alpha_of, attributes_of, beyond_half
from .sequences import Sequence

LEAST_COLOR = 0.01  # of a pixel with light: gloss may have spread to a pixel whose own glossy colour is 0


def write_light(
    out: Path,  # folder
    sequence: Sequence,
    index: int,
    passes: LightPasses,
    picture: np.ndarray,  # [1, 3, H, W] the beauty
    parts: dict[str, np.ndarray],  # name of a pass -> [1, 3, H, W] radiance, colours and `also`; others stay
    *,
    layout: str = "plain",
    float32: bool = False,
    alpha: str = "auto",
    coverage: np.ndarray | None = None,  # as for `write_frame`
) -> dict[str, int]:
    """Write one frame under the name of its input file. Returns the number of NaNs in each channel that is passed on.

    plain    the beauty in `R,G,B`, its alpha in `A`, and the layers of `also` under their names
    source   a copy of the input with the denoised passes in place of the noisy ones. A light is divided by its colour
             again, so (Direct + Indirect) · Color summed over all lobes and the other passes is the new Combined.

    Raises InputError where a result is not finite, and where the file cannot be written.
    """
    path = sequence.paths[index]
    for name, image in {"the picture": picture, **parts}.items():
        if bad := int((~np.isfinite(image)).any(1).sum()):
            raise InputError(f"{path}: {name} has {bad} pixels that are not finite after denoising, so nothing was "
                             "written; are the weights of --model sound, and the frame plausible?")  # fmt: skip
    covered = alpha_of(sequence, index, picture, alpha, coverage)
    picture = sequence.within(picture)
    covered, parts = ({name: sequence.within(plane) for name, plane in its.items()} for its in (covered, parts))
    float32 = float32 or any(map(beyond_half, (picture, *parts.values())))
    if layout == "source":
        planes = _source_planes(sequence, passes, picture, parts) | ({} if alpha == "rendered" else covered)
        float32 = float32 or any(map(beyond_half, planes.values()))  # what a dark colour divides is brighter
        return write_like(out / path.name, path, planes, dtype="float" if float32 else None)
    layers: dict[str, np.ndarray] = {"color": np.moveaxis(picture[0], 0, 2)}
    for name in passes.also:  # by full channel names: a layer may be called `color` or `A`
        layers |= zip((f"{name}.{c}" for c in "RGB"), parts[name][0], strict=True)
    if covered:
        (layers["A"],) = covered.values()
    dtypes = dict.fromkeys(layers, "float" if float32 else "half")
    write_layers(out / sequence.names[index], layers, dtypes=dtypes, attributes=attributes_of(sequence, index))
    return {}


def _source_planes(
    sequence: Sequence, passes: LightPasses, picture: np.ndarray, parts: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    beauty = sequence.layout.beauty_rule(sequence.header) or PLAIN
    planes = dict(zip(beauty.channels, picture[0], strict=True))
    for name, rule in {**passes.volumes, **passes.passed, **passes.also}.items():
        if name in parts:
            planes |= zip(rule.channels, parts[name][0], strict=True)
    for lobe, rule in passes.colors.items():
        mine = [name for name in passes.lights if name.split()[0] == lobe]
        color = np.where(sum(parts[name] for name in mine) > 0, np.maximum(parts[lobe], LEAST_COLOR), parts[lobe])
        planes |= zip(rule.channels, color[0], strict=True)
        for name in mine:
            light = np.divide(parts[name], color, out=np.zeros_like(color), where=color > 0)
            planes |= zip(passes.lights[name].channels, light[0], strict=True)
    return planes
