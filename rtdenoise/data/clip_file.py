"""Training clips on disk: one safetensors file for each clip, written atomically, read in slices. Needs no renderer.

`clip_000123.safetensors` holds tensors `[T, C, H, W]` under the names and in the types of `layers.py`. Every clip has
the layers of `FEATURES` and those of `RADIANCE` of one signal or both; some have more. The header carries the clip's
facts as JSON under "clip", and under "scales" the factors of the float16 layers that were divided to stay below 65504.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from reprlib import repr
from typing import TYPE_CHECKING

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..constants import MAX_HALF
from ..errors import InputError
from ..files import in_order, open_regular, write_atomically
from .layers import LAYERS, SIGNALS

if TYPE_CHECKING:
    from torch import Tensor

RADIANCE = tuple(layer for names in zip(*(SIGNALS[s].values() for s in SIGNALS), strict=True) for layer in names)
FEATURES = tuple(name for name, layer in LAYERS.items() if layer.in_every_clip and name not in RADIANCE)
OPTIONAL = tuple(name for name, layer in LAYERS.items() if not layer.in_every_clip)
LEAD_IN = "lead_in"  # fact of a clip: how many of its frames, the first ones, have no references
STORED_TYPES = {np.float16: "F16", np.float32: "F32", np.uint16: "U16"}  # numpy's -> the name of safetensors
MAX_SCALE = 1024.0  # more would leave half precision no digits for dark pixels; beyond it values are clamped


def clip_path(folder: Path, index: int) -> Path:
    return Path(folder) / f"clip_{index:06d}.safetensors"


def write_clip(
    path: Path,
    frames: list[
        Mapping[str, np.ndarray]
    ],  # consecutive frames: layer -> [H, W, C]; all of `FEATURES` and of the signals
    facts: Mapping,  # JSON
    layers: Collection[str] = (),  # those of `OPTIONAL` to write too
    signals: Collection[str] = tuple(SIGNALS),  # those that the frames have
) -> None:
    """Write a clip. Float16 layers of every clip are clamped to ±65504; optional ones are scaled instead.

    Raises ValueError for an unknown layer and for values that are not finite, InputError for more object ids than
    clips can number.
    """
    if unknown := set(layers) - set(OPTIONAL):
        raise ValueError(f"{path}: unknown layer {unknown.pop()}; optional layers are {', '.join(OPTIONAL)}")
    tensors, scales = {}, {}
    radiance = [name for name in RADIANCE if any(name in SIGNALS[signal].values() for signal in signals)]
    for name in (*radiance, *FEATURES, *layers):
        values = np.stack([frame[name] for frame in frames]).transpose(0, 3, 1, 2)
        dtype = LAYERS[name].clip_type
        if name == "id" and values.max() > np.iinfo(dtype).max:
            raise InputError(f"{path}: object {values.max():.0f}: clips number at most {np.iinfo(dtype).max} objects; "
                             "merge some of the scene's")  # fmt: skip
        if dtype is np.float16:
            if name in layers and (scale := _scale(values)) > 1:
                values, scales[name] = values / scale, scale
            values = np.clip(values, -MAX_HALF, MAX_HALF)
        tensors[name] = np.ascontiguousarray(values, dtype)
        if not np.isfinite(tensors[name]).all():
            raise ValueError(f"{path}: {name} is not finite")
    metadata = {"clip": json.dumps(dict(facts))} | ({"scales": json.dumps(scales)} if scales else {})
    write_atomically(path, in_order(save(tensors, metadata=metadata)))


def bytes_per_clip(size: tuple[int, int], frames: int, layers: Collection[str] = ()) -> int:
    """Size of a clip's file without its header; size = (height, width), `layers` the optional ones."""
    stored = [LAYERS[name] for name in (*RADIANCE, *FEATURES, *layers)]
    return frames * size[0] * size[1] * sum(np.dtype(layer.clip_type).itemsize * layer.channels for layer in stored)


def read_facts(path: Path) -> dict:
    """The facts of a clip: seed, samples, uncovered share and so on. Raises InputError if the file is no clip."""
    with opened(path) as clip:
        return facts_of(path, clip)


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """Every layer of a clip, `[T, C, H, W]` float32. Raises InputError if the file is no clip."""
    with opened(path) as clip:
        scales, names = scales_of(path, clip), clip.keys()
        size_of(path, clip, {name for name in names if name in LAYERS})
        return {n: unscaled(clip.get_tensor(n), scales.get(n)).numpy() for n in names}


def opened(path: Path):
    """The file, open. Raises InputError where it is no safetensors file."""
    open_regular(path).close()
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable clip ({error}); delete it and render it again") from error


def facts_of(path: Path, clip) -> dict:
    """The facts of an open clip. Raises InputError where the facts that loading depends on are none."""
    facts = _from_header(path, clip, "clip")
    lead_in, spp = facts.get(LEAD_IN, 0), facts.get("spp", 1)
    if type(lead_in) is not int or lead_in < 0 or type(spp) not in (int, float) or not spp > 0:
        raise InputError(f"{path}: damaged: {LEAD_IN} is {repr(lead_in)}, spp {repr(spp)}, expected counts; delete it "
                         "and render it again")  # fmt: skip
    return facts


def size_of(path: Path, clip, names: Collection[str]) -> tuple[int, int, int]:
    """Frames, height and width. Raises InputError unless these layers have their types and channels, and one size."""
    sizes = set()
    for name in sorted(names):
        layer, stored = LAYERS[name], clip.get_slice(name)
        shape, dtype = stored.get_shape(), stored.get_dtype()
        expected = STORED_TYPES[layer.clip_type]
        if len(shape) != 4 or shape[1] != layer.channels or 0 in shape or dtype != expected:
            raise InputError(f"{path}: damaged: layer '{name}' is {dtype} {shape}, expected {expected} "
                             f"[T, {layer.channels}, H, W]; delete the clip and render it again")  # fmt: skip
        sizes.add((shape[0], *shape[2:]))
    if len(sizes) > 1:
        raise InputError(f"{path}: damaged: layers of {len(sizes)} sizes (frames, height, width), such as "
                         f"{min(sizes)} and {max(sizes)}; delete the clip and render it again")  # fmt: skip
    return sizes.pop() if sizes else (0, 0, 0)


def scales_of(path: Path, clip) -> dict[str, float]:
    """Layer -> what its float16 values were divided by. Raises InputError for scales that `write_clip` never writes."""
    scales = _from_header(path, clip, "scales") if "scales" in (clip.metadata() or {}) else {}
    if not all(name in LAYERS and type(scale) is float and 1 <= scale <= MAX_SCALE for name, scale in scales.items()):
        raise InputError(f"{path}: damaged: its scales are {repr(scales)}; delete it and render it again")
    return scales


def _scale(values: np.ndarray) -> float:
    """The least power of two that brings the values within float16, at most `MAX_SCALE`."""
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0))
    return min(2.0 ** max(math.ceil(math.log2(largest / MAX_HALF)), 0), MAX_SCALE) if largest > MAX_HALF else 1.0


def unscaled(stored: Tensor, scale: float | None) -> Tensor:
    """A layer as it was before it was divided, float32."""
    return stored.float() if scale is None else stored.float() * scale


def _from_header(path: Path, clip, key: str) -> dict:
    try:
        value = json.loads(clip.metadata()[key])
    except (KeyError, TypeError, ValueError, RecursionError):  # TypeError: no metadata at all
        value = None
    if not isinstance(value, dict):
        raise InputError(f"{path}: not a clip: its header has no JSON object '{key}'; delete it and render it again")
    return value
