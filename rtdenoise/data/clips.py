"""Training clips on disk: one safetensors file a clip, written atomically, read in slices. Needs no renderer.

`clip_000123.safetensors` holds tensors `[T, C, H, W]`: float16 radiance, albedo and normal; float32 depth and motions
(half precision would cost subpixels); uint16 id (uint8 in older ones). Its header carries the clip's facts as JSON
under "clip".
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..errors import InputError
from ..files import write_atomically
from ..frame import Frame

RADIANCE = ("color", "indirect", "reference", "indirect_reference", "reference_half", "indirect_reference_half")
DTYPES = {"depth": np.float32, "motion": np.float32, "motion_next": np.float32, "id": np.uint16}
SIGNALS = {
    "color": {"radiance": "color", "reference": "reference", "reference_half": "reference_half"},
    "indirect": {
        "radiance": "indirect", "reference": "indirect_reference", "reference_half": "indirect_reference_half",
    },
}  # fmt: skip
FEATURES = ("albedo", "normal", "depth", "motion", "motion_next", "id")


def clip_path(folder: Path, index: int) -> Path:
    return Path(folder) / f"clip_{index:06d}.safetensors"


def write_clip(path: Path, frames: list[Mapping[str, np.ndarray]], facts: Mapping) -> None:
    """Write consecutive frames, layers [H, W, C] each, under the names that `RADIANCE` and `FEATURES` list."""
    tensors = {}
    for name in (*RADIANCE, *FEATURES):
        stacked = np.stack([frame[name] for frame in frames]).transpose(0, 3, 1, 2)
        dtype = DTYPES.get(name, np.float16)
        if name == "id" and stacked.max() > np.iinfo(dtype).max:
            raise InputError(f"{path}: object {stacked.max():.0f}: clips number at most {np.iinfo(dtype).max} objects; "
                             "merge some of the scene's")  # fmt: skip
        if dtype is np.float16:
            limit = float(np.finfo(np.float16).max)
            stacked = np.clip(stacked, -limit, limit)
        tensors[name] = np.ascontiguousarray(stacked, dtype)
        if not np.isfinite(tensors[name]).all():
            raise ValueError(f"{path}: {name} is not finite")
    write_atomically(path, save(tensors, metadata={"clip": json.dumps(dict(facts))}))


def bytes_per_clip(size: tuple[int, int], frames: int) -> int:
    """Size of a clip's file, but for its header; size = (height, width)."""
    widths = {name: np.dtype(DTYPES.get(name, np.float16)).itemsize for name in (*RADIANCE, *FEATURES)}
    components = {"depth": 1, "motion": 2, "motion_next": 2, "id": 1}
    return frames * size[0] * size[1] * sum(width * components.get(name, 3) for name, width in widths.items())


def read_facts(path: Path) -> dict:
    """The facts of a clip: seed, samples, uncovered share and so on."""
    with _opened(path) as clip:
        return json.loads(clip.metadata()["clip"])


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
        """The scenes that the clips show: a scene file's name, or a generator's version and seed. Textures and objects
        of a generated scene are drawn from its seed, so other seeds share nothing with it."""
        return {_scene(self.facts(index)) for index in range(len(self))}

    def load(
        self,
        index: int,
        *,
        signal: str = "color",  # color | indirect
        size: int | tuple[int, int] | None = None,  # of the window, (height, width); None: the whole image
        frames: int | None = None,  # how many consecutive ones; None: all
        rng: np.random.Generator | None = None,  # draws window and first frame; None: centre and first
    ) -> list[Frame]:
        """Consecutive frames of clip `index`, tensors [1, C, H, W] float32, of one random window; no more is read."""
        path = self.paths[index]
        if signal not in SIGNALS:
            raise InputError(f"unknown signal '{signal}'; expected {' or '.join(SIGNALS)}")
        with _opened(path) as clip:
            length, _, height, width = clip.get_slice("color").get_shape()
            count = length if frames is None else frames
            window = (height, width) if size is None else (size, size) if isinstance(size, int) else size
            if count > length or window[0] > height or window[1] > width:
                raise InputError(f"{path}: expected at least {count} frames of {window[1]}×{window[0]}, "
                                 f"found {length} of {width}×{height}")  # fmt: skip
            room = (length - count, height - window[0], width - window[1])
            first, top, left = rng.integers(0, room, endpoint=True) if rng else (0, room[1] // 2, room[2] // 2)
            layers = SIGNALS[signal] | {name: name for name in FEATURES}
            time, rows, columns = (
                slice(start, start + length) for start, length in zip((first, top, left), (count, *window), strict=True)
            )
            tensors = {field: clip.get_slice(layer)[time, :, rows, columns].float() for field, layer in layers.items()}
        return [
            Frame(**{field: t[i : i + 1] for field, t in tensors.items()}, number=int(first) + i, name=path.name)
            for i in range(count)
        ]


def _scene(facts: dict) -> str:
    if facts.get("kind") == "scene file":
        return facts["source"]
    return f"generator {facts.get('generator')}, seed {facts.get('scene_seed', facts['seed'])}"


def _opened(path: Path):
    try:
        return safe_open(path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable clip ({error}); delete it and render it again") from error
