"""Folders of training clips: consecutive frames of one clip, of a random window, and denoised frames beside them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from safetensors.numpy import load_file, save

from ..constants import MAX_HALF
from ..errors import InputError
from ..files import write_atomically
from ..frame import Frame
from .clip_file import FEATURES, LEAD_IN, facts_of, opened, read_facts, scales_of, size_of, unscaled
from .layers import COMPONENTS, SIGNALS

if TYPE_CHECKING:
    from torch import Tensor

SHOT = "shot"  # kind of the clips that are cut from frames on disk
NAMED = ("scene file", "calm scene file", SHOT)  # kinds of clips whose scene has a name, their source
REPEAT = "delete it and make it again: rtdenoise estimates"


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
        with opened(self.paths[index]) as clip:
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
        with opened(path) as clip:
            sources, (length, height, width), (count, *window) = _examined(path, clip, signal, size, frames, layers)
            skipped = facts_of(path, clip).get(LEAD_IN, 0)
            room = (length - skipped - count, height - window[0], width - window[1])
            first, top, left = rng.integers(0, room, endpoint=True) if rng else (0, room[1] // 2, room[2] // 2)
            first = skipped + int(first)
            time = slice(max(first - lead_in, 0), first + count)
            rows, columns = slice(top, top + window[0]), slice(left, left + window[1])
            scales = scales_of(path, clip)
            tensors = {
                field: _stacked([unscaled(clip.get_slice(n)[time, :, rows, columns], scales.get(n)) for n in names])
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
    length, height, width = size_of(path, clip, {name for names in sources.values() for name in names})
    usable = length - facts_of(path, clip).get(LEAD_IN, 0)
    count = usable if frames is None else frames
    window = (height, width) if size is None else (size, size) if isinstance(size, int) else size
    if not 0 < count <= usable or window[0] > height or window[1] > width:
        raise InputError(f"{path}: expected at least {count} frames of {window[1]}×{window[0]}, "
                         f"found {usable} of {width}×{height}; take fewer --frames or a smaller --size")  # fmt: skip
    return sources, (length, height, width), (count, *window)


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


def _stacked(tensors: list[Tensor]) -> Tensor:
    """The tensors joined along the channels; a single one is not copied."""
    import torch

    return tensors[0] if len(tensors) == 1 else torch.cat(tensors, 1)


def _scene(path: Path, facts: dict) -> str:
    try:
        if facts.get("kind") in NAMED:
            return str(facts["source"])
        if facts.get("kind") == "composed":
            return f"composition {facts['scene']}, seed {facts['seed']}"
        return f"generator {facts.get('generator')}, seed {facts.get('scene_seed', facts['seed'])}"
    except KeyError as missing:
        raise InputError(f"{path}: its facts lack {missing}; delete it and render it again") from None


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
    with opened(path) as file:
        known = (file.metadata() or {}).get("origin", "")
        return tuple(file.keys()) if origin in (None, known) else ()


def _read_estimates(clip: Path, method: str, signal: str, size: tuple[int, int, int]):
    """The tensor `[T, 3, H, W]`, not read yet. `size`: frames, height and width of the clip."""
    path = estimate_path(clip, method)
    if signal not in estimated_signals(clip, method):
        raise InputError(f"{path}: has no denoised frames of the signal {signal}; make them: rtdenoise estimates "
                         f"{clip.parent} --methods {method} --signal {signal}")  # fmt: skip
    with opened(path) as file:
        stored, (length, height, width) = file.get_slice(signal), size
        shape, dtype = stored.get_shape(), stored.get_dtype()
        if shape != [length, 3, height, width] or dtype != "F16":
            raise InputError(f"{path}: damaged, or of another clip: {dtype} {shape}, expected F16 "
                             f"{[length, 3, height, width]}; {REPEAT}")  # fmt: skip
        return stored
