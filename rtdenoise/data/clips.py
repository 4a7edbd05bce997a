"""Training clips on disk: one safetensors file for each clip, written atomically, read in slices. Needs no renderer.

`clip_000123.safetensors` holds tensors `[T, C, H, W]` under the names and in the types of `layers.py`. Every clip has
the layers of `FEATURES` and those of `RADIANCE` of one signal or both; some have more. The header carries the clip's
facts as JSON under "clip", and under "scales" the factors of the float16 layers that were divided to stay below 65504.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from reprlib import repr
from typing import TYPE_CHECKING

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save

from ..constants import MAX_HALF
from ..errors import InputError
from ..files import in_order, open_regular, write_atomically
from ..frame import Frame
from .layers import COMPONENTS, LAYERS, SIGNALS

if TYPE_CHECKING:
    from torch import Tensor

RADIANCE = tuple(layer for names in zip(*(SIGNALS[s].values() for s in SIGNALS), strict=True) for layer in names)
FEATURES = tuple(name for name, layer in LAYERS.items() if layer.in_every_clip and name not in RADIANCE)
OPTIONAL = tuple(name for name, layer in LAYERS.items() if not layer.in_every_clip)
LEAD_IN = "lead_in"  # fact of a clip: how many of its frames, the first ones, have no references
SHOT = "shot"  # kind of the clips that are cut from frames on disk
REPEAT = "delete it and make it again: rtdenoise estimates"
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
    with _opened(path) as clip:
        return _facts(path, clip)


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """Every layer of a clip, `[T, C, H, W]` float32. Raises InputError if the file is no clip."""
    with _opened(path) as clip:
        scales, names = _scales(path, clip), clip.keys()
        _size(path, clip, {name for name in names if name in LAYERS})
        return {n: _unscaled(clip.get_tensor(n), scales.get(n)).numpy() for n in names}


def estimate_path(clip: Path, method: str) -> Path:
    """The file with the denoised frames of a clip: CLIPS/METHOD/clip_000000.safetensors, a tensor `[T, 3, H, W]`
    float16 for each signal."""
    return clip.parent / method / clip.name


def write_estimates(clip: Path, method: str, estimates: Mapping[str, np.ndarray], origin: str = "") -> None:
    """Write the denoised frames of a clip, signal -> `[T, 3, H, W]`; signals that the file has already are kept, if
    they are of the same `origin`: whatever changes with the clip and with the method."""
    path = estimate_path(clip, method)
    path.parent.mkdir(exist_ok=True)
    before = load_file(path) if estimated_signals(clip, method, origin) else {}
    now = {signal: np.clip(z, 0, MAX_HALF).astype(np.float16) for signal, z in estimates.items()}
    write_atomically(path, save(before | now, {"origin": origin}))


def estimated_signals(clip: Path, method: str, origin: str | None = None) -> tuple[str, ...]:
    """The signals for which a method's file has denoised frames of a clip, of that `origin` or any."""
    path = estimate_path(clip, method)
    if not path.is_file():
        return ()
    with _opened(path) as file:
        known = (file.metadata() or {}).get("origin", "")
        return tuple(file.keys()) if origin in (None, known) else ()


class ClipDataset:
    """The clips of one or more folders, folder by folder in the order of their names."""

    def __init__(self, *folders: str | Path):
        self.paths: list[Path] = []
        for folder in folders:
            found = sorted(Path(folder).glob("clip_*.safetensors"))
            if not found:
                raise InputError(f"{folder}: no clips found; expected files clip_000000.safetensors and so on")
            self.paths += found

    def __len__(self) -> int:
        return len(self.paths)

    def facts(self, index: int) -> dict:
        return read_facts(self.paths[index])

    def scenes(self) -> set[str]:
        """The scenes that the clips show: the name of a scene file, the folder of a shot, the number and seed of a
        composition of assets, or the version and seed of a generator. A generator draws textures and objects from its
        seed, so scenes of different seeds share nothing."""
        return {_scene(path, read_facts(path)) for path in self.paths}

    def examine(
        self,
        index: int,
        *,
        signal: str = "color",
        size: int | tuple[int, int] | None = None,
        frames: int | None = None,
        layers: Collection[str] = (),
    ) -> None:
        """Raise InputError where `load` would, from the header of clip `index` alone."""
        with _opened(self.paths[index]) as clip:
            _examined(self.paths[index], clip, signal, size, frames, layers)

    def load(
        self,
        index: int,
        *,
        signal: str = "color",  # color | indirect
        size: int | tuple[int, int] | None = None,  # of the window, (height, width); None: the whole image
        frames: int | None = None,  # how many consecutive ones with references; None: all
        lead_in: int = 0,  # so many of the frames before these too, or all there are
        rng: np.random.Generator | None = None,  # draws window and first frame; None: centre and first
        layers: Collection[str] = (),  # layers of `Frame` to load too: "position"
        estimates: str = "",  # method whose denoised frames to load too (`estimate_path`)
    ) -> list[Frame]:
        """Consecutive frames of clip `index`, tensors [1, C, H, W] float32, of one random window; no more is read.

        With `lead_in` those before them come first; some of these have references of zero (`LEAD_IN`). With `estimates`
        as many frames follow whose radiance is the denoised one.

        `Frame.samples`, and for the signal `color` `Frame.components`, are loaded from the clips that have them. Raises
        InputError for an unknown signal, a clip that is too small, and a signal or layer that the clip lacks.
        """
        path = self.paths[index]
        with _opened(path) as clip:
            sources, (length, height, width), (count, *window) = _examined(path, clip, signal, size, frames, layers)
            skipped = _facts(path, clip).get(LEAD_IN, 0)
            room = (length - skipped - count, height - window[0], width - window[1])
            first, top, left = rng.integers(0, room, endpoint=True) if rng else (0, room[1] // 2, room[2] // 2)
            first = skipped + int(first)
            time = slice(max(first - lead_in, 0), first + count)
            rows, columns = slice(top, top + window[0]), slice(left, left + window[1])
            scales = _scales(path, clip)
            tensors = {
                field: _stacked([_unscaled(clip.get_slice(n)[time, :, rows, columns], scales.get(n)) for n in names])
                for field, names in sources.items()
            }
        loaded = [
            Frame(**{field: t[i : i + 1] for field, t in tensors.items()}, number=number, name=path.name)
            for i, number in enumerate(range(time.start, time.stop))
        ]
        if not estimates:
            return loaded
        denoised = _read_estimates(path, estimates, signal, (length, height, width))[time, :, rows, columns].float()
        if not denoised.isfinite().all():
            raise InputError(f"{estimate_path(path, estimates)}: damaged: not finite; {REPEAT}")
        return loaded + [replace(frame, radiance=denoised[i : i + 1]) for i, frame in enumerate(loaded)]


def _examined(
    path: Path, clip, signal: str, size: int | tuple[int, int] | None, frames: int | None, layers: Collection[str]
) -> tuple[dict[str, tuple[str, ...]], tuple[int, int, int], tuple[int, int, int]]:
    """(`_sources`, `_size`, frames, height and width of the window) of an open clip; see `ClipDataset.load`."""
    if signal not in SIGNALS:
        raise InputError(f"unknown signal '{signal}'; expected {' or '.join(SIGNALS)}")
    sources = _sources(path, set(clip.keys()), signal, layers)
    length, height, width = _size(path, clip, {name for names in sources.values() for name in names})
    usable = length - _facts(path, clip).get(LEAD_IN, 0)
    count = usable if frames is None else frames
    window = (height, width) if size is None else (size, size) if isinstance(size, int) else size
    if not 0 < count <= usable or window[0] > height or window[1] > width:
        raise InputError(f"{path}: expected at least {count} frames of {window[1]}×{window[0]}, "
                         f"found {usable} of {width}×{height}; take fewer --frames or a smaller --size")  # fmt: skip
    return sources, (length, height, width), (count, *window)


def _facts(path: Path, clip) -> dict:
    """Raises InputError where the facts that loading depends on are none."""
    facts = _from_header(path, clip, "clip")
    lead_in, spp = facts.get(LEAD_IN, 0), facts.get("spp", 1)
    if type(lead_in) is not int or lead_in < 0 or type(spp) not in (int, float) or not spp > 0:
        raise InputError(f"{path}: damaged: {LEAD_IN} is {repr(lead_in)}, spp {repr(spp)}, expected counts; delete it "
                         "and render it again")  # fmt: skip
    return facts


def _read_estimates(clip: Path, method: str, signal: str, size: tuple[int, int, int]):
    """The tensor `[T, 3, H, W]`, not read yet. `size`: frames, height and width of the clip."""
    path = estimate_path(clip, method)
    if signal not in estimated_signals(clip, method):
        raise InputError(f"{path}: has no denoised frames of the signal {signal}; make them: rtdenoise estimates "
                         f"{clip.parent} --methods {method} --signal {signal}")  # fmt: skip
    with _opened(path) as file:
        stored, (length, height, width) = file.get_slice(signal), size
        shape, dtype = stored.get_shape(), stored.get_dtype()
        if shape != [length, 3, height, width] or dtype != "F16":
            raise InputError(f"{path}: damaged, or of another clip: {dtype} {shape}, expected F16 "
                             f"{[length, 3, height, width]}; {REPEAT}")  # fmt: skip
        return stored


def _sources(path: Path, stored: set[str], signal: str, asked: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Layer of `Frame` -> the layers of the clip that make it."""
    optional = {"position": ("position",), "samples": ("samples",)}
    if signal == "color":
        optional["components"] = COMPONENTS
    found = {field: (name,) for field, name in SIGNALS[signal].items()} | {name: (name,) for name in FEATURES}
    stored_signals = [name for name in SIGNALS if SIGNALS[name]["radiance"] in stored]
    if stored_signals and signal not in stored_signals:
        raise InputError(f"{path}: has no signal '{signal}'; give --signal {stored_signals[0]}")
    asked_layers = (name for field in asked for name in optional.get(field, (field,)))
    wanted = [*SIGNALS[signal].values(), *FEATURES, *asked_layers]
    if missing := [name for name in wanted if name not in stored]:
        raise InputError(f"{path}: has no layer '{missing[0]}'; it has {', '.join(sorted(stored))}")
    return found | {
        field: names
        for field, names in optional.items()
        if stored.issuperset(names) and (field != "position" or field in asked)
    }


def _size(path: Path, clip, names: Collection[str]) -> tuple[int, int, int]:
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


def _unscaled(stored: Tensor, scale: float | None) -> Tensor:
    return stored.float() if scale is None else stored.float() * scale


def _stacked(tensors: list[Tensor]) -> Tensor:
    """The tensors joined along the channels; a single one is not copied."""
    import torch

    return tensors[0] if len(tensors) == 1 else torch.cat(tensors, 1)


def _scale(values: np.ndarray) -> float:
    """The least power of two that brings the values within float16, at most `MAX_SCALE`."""
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0))
    return min(2.0 ** max(math.ceil(math.log2(largest / MAX_HALF)), 0), MAX_SCALE) if largest > MAX_HALF else 1.0


def _scales(path: Path, clip) -> dict[str, float]:
    scales = _from_header(path, clip, "scales") if "scales" in (clip.metadata() or {}) else {}
    if not all(name in LAYERS and type(scale) is float and 1 <= scale <= MAX_SCALE for name, scale in scales.items()):
        raise InputError(f"{path}: damaged: its scales are {repr(scales)}; delete it and render it again")
    return scales


def _from_header(path: Path, clip, key: str) -> dict:
    try:
        value = json.loads(clip.metadata()[key])
    except (KeyError, TypeError, ValueError, RecursionError):  # TypeError: no metadata at all
        value = None
    if not isinstance(value, dict):
        raise InputError(f"{path}: not a clip: its header has no JSON object '{key}'; delete it and render it again")
    return value


def _scene(path: Path, facts: dict) -> str:
    try:
        if facts.get("kind") in ("scene file", SHOT):
            return str(facts["source"])
        if facts.get("kind") == "composed":
            return f"composition {facts['scene']}, seed {facts['seed']}"
        return f"generator {facts.get('generator')}, seed {facts.get('scene_seed', facts['seed'])}"
    except KeyError as missing:
        raise InputError(f"{path}: its facts lack {missing}; delete it and render it again") from None


def _opened(path: Path):
    open_regular(path).close()
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable clip ({error}); delete it and render it again") from error
