"""The light of a frame by Metropolis sampling (PSSMLT), split by the kind of mutation.

Mutations take the place of samples. Their light falls into two pictures that add up to the beauty: `large`, of states
that a large step made (all random numbers new), and `small`, of states that small steps made. A third picture,
`proposals`, is path traced from the large proposals alone, accepted or not: it is unbiased by itself, and without the
blotches that long stays of a chain leave. `chains.py` has the mathematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..errors import InputError
from .stage import Stage, start_mitsuba
from .streams import NOISY

PIXELS_PER_CHAIN = 4  # where the number of chains is not given,
FEWEST, MOST = 64, 1 << 16  # within these


@dataclass(frozen=True)
class MetropolisOptions:
    """The options of Metropolis sampling."""

    chains: int = 0  # in parallel; 0: one for every PIXELS_PER_CHAIN pixels
    seed: Literal["frame", "same"] = "frame"  # of the noisy frames: another one for each, or the same for all
    attribution: Literal["made", "replaced"] = "made"  # a state's light counts for the step that made or replaced it
    references: Literal["pssmlt", "path"] = "pssmlt"  # how references are rendered


def chains_of(options: MetropolisOptions, size: tuple[int, int], mutations: int) -> int:
    """The number of chains for a picture. Raises InputError where they are more than its mutations."""
    pixels = size[0] * size[1]
    count = options.chains or int(np.clip(pixels // PIXELS_PER_CHAIN, FEWEST, MOST))
    if options.chains > mutations * pixels:
        raise InputError(f"--chains {count}: {size[1]}×{size[0]} pixels with {mutations} mutations each have only "
                         f"{mutations * pixels} mutations; expected at most as many chains")  # fmt: skip
    return min(count, mutations * pixels)


def metropolis(
    stage: Stage,
    number: int,
    size: tuple[int, int],
    mutations: int,  # a pixel, rounded to whole steps of all chains
    seed: int,
    stream: int,
    max_depth: int,
    options: MetropolisOptions = MetropolisOptions(),
    law: dict | None = None,  # of `chains.Law`, where it differs
) -> tuple[dict[str, np.ndarray], dict]:
    """(`color`, `indirect`, `large`, `small`, `proposals`, [H, W, 3] float32 each; facts about the run) of frame
    `number`. `large` + `small` is `color` to the last bit.

    Raises InputError where no path finds light, or chains outnumber mutations.
    """
    mi = start_mitsuba()
    import drjit as dr

    from . import chains, tracing

    stage.at(number)
    count, pixels = chains_of(options, size, mutations), size[0] * size[1]
    steps = max(round(mutations * pixels / count), 1)
    view = tracing.view_of(stage.scene.camera(number), size)
    height, width = (dr.opaque(mi.UInt32, side) for side in size)
    picture = chains.Picture(stage.mitsuba, stage.kinds, view, height, width, pixels, max_depth, stage.holes)
    key = (seed, stream) if options.seed == "same" and stream == NOISY else (seed, stream, number)
    moves = chains.Law(**{"replaced": options.attribution == "replaced"} | (law or {}))
    walked, films, values, first = chains.walk(picture, count, steps, moves, (len(key), *key))
    if walked is None:
        raise InputError(f"{stage.scene.file or stage.scene.name}: frame {number}: none of {len(values)} paths finds "
                         "light; move the camera, give lamps an area, or raise --max-depth")  # fmt: skip

    large = np.array(walked.proposed, np.float64).sum()
    seen = len(values) + large  # independent paths
    b = (values.sum() + np.array(walked.total, np.float64).sum()) / seen
    squares = ((values**2).sum() + np.array(walked.squares, np.float64).sum()) / seen
    scale = stage.exposure * pixels / (count * steps)

    def image(film, *shape) -> np.ndarray:
        return np.array(film, np.float64).reshape(*size, *shape, 3)

    by = image(films.chains, 2) * (b / first)
    by[..., 0, :] += image(films.large)
    by = (by * scale).astype(np.float32)
    indirect = (image(films.chains_indirect) * (b / first) + image(films.large_indirect)) * scale
    layers = {
        "color": by[..., 0, :] + by[..., 1, :],
        "indirect": indirect.astype(np.float32),
        "large": np.ascontiguousarray(by[..., 0, :]),
        "small": np.ascontiguousarray(by[..., 1, :]),
        "proposals": (image(films.proposals) * (stage.exposure * pixels / max(large, 1))).astype(np.float32),
    }
    small = count * steps - large
    facts = {
        "chains": count,
        "mutations": count * steps / pixels,  # a pixel, as rendered
        "bootstrap": len(values),
        "brightness": b * stage.exposure,
        "brightness_error": float(np.sqrt(max(squares / b**2 - 1, 0) / seen)),  # relative, standard
        "accepted": {
            "large": float(np.array(walked.taken_large, np.float64).sum() / max(large, 1)),
            "small": float(np.array(walked.taken_small, np.float64).sum() / max(small, 1)),
        },
    }
    return layers, facts


def unseen_lamps(stage: Stage) -> str:
    """A warning where the scene has lamps whose light through smooth glass and off mirrors no path finds; else ""."""
    mi = start_mitsuba()
    points = int(mi.EmitterFlags.DeltaPosition) | int(mi.EmitterFlags.DeltaDirection)
    lamps = sum(lamp.flags() & points > 0 for lamp in stage.mitsuba.emitters())
    smooth = int(mi.BSDFFlags.DeltaTransmission) | int(mi.BSDFFlags.DeltaReflection)
    glass = sum(shape.bsdf().flags() & smooth > 0 for shape in stage.mitsuba.shapes() if shape.bsdf())
    if not lamps or not glass:
        return ""
    return (f"{stage.scene.file or stage.scene.name}: {lamps} lamps without area (spot, point, sun) and {glass} smooth "
            "glass or mirror surfaces: the caustics of these lamps are missing; give the lamps an area")  # fmt: skip
