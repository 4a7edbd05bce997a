"""Pictures from files as textures of some surfaces: photographs have detail that generated patterns lack."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from ...color import srgb_decode
from ...errors import InputError
from ...files import open_regular
from .scene import Material, Object, Scene
from .textures import SIZE

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
LICENCES = ("LICENSE.txt", "LICENSE", "LICENSE.md")
PICTURE_SHARE = 0.4  # of the surfaces that can have a picture
MIN_SIDE = 16  # pixels; smaller pictures are icons


@dataclass(frozen=True)
class Pictures:
    """The pictures of a folder, in the order of their names."""

    folder: Path
    names: tuple[str, ...]

    @property
    def licence(self) -> str:
        """Text of the folder's licence file; "" without one."""
        found = [self.folder / name for name in LICENCES if (self.folder / name).is_file()]
        return found[0].read_text(encoding="utf-8", errors="replace") if found else ""

    def texture(self, name: str, rng: np.random.Generator) -> np.ndarray:
        """A random square of a picture as reflectance in [0.02, 0.92], `[SIZE, SIZE, 3]` float32, linear RGB; sides
        are half of its shorter side to all of it."""
        image = _small(self.folder / name)
        height, width = image.shape[:2]
        side = int(min(height, width) * rng.uniform(0.5, 1))
        top, left = (int(rng.integers(0, room, endpoint=True)) for room in (height - side, width - side))
        window = srgb_decode(torch.from_numpy(image[top : top + side, left : left + side] / np.float32(255)))
        channels = [
            Image.fromarray(plane.contiguous().numpy()).resize((SIZE, SIZE), Image.Resampling.BILINEAR)
            for plane in window.unbind(-1)
        ]
        return np.clip(np.stack(channels, -1), 0.02, 0.92)


@lru_cache(maxsize=8)
def find_pictures(folder: str | Path) -> Pictures:
    """The PNG, JPEG and WebP files of a folder, all of which can be opened. Raises `InputError`."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one with pictures ({', '.join(SUFFIXES)})")
    names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
    if not names:
        raise InputError(f"{folder}: no pictures found; expected {', '.join(SUFFIXES)} files")
    for name in names:
        with _opened(folder / name) as image:
            if image.mode[0] in "IF" or min(image.size) < MIN_SIDE:
                raise InputError(f"{folder / name}: is {image.size[0]}×{image.size[1]} of mode {image.mode}, expected "
                                 f"8 bits a channel and at least {MIN_SIDE} pixels a side")  # fmt: skip
    return Pictures(folder, tuple(names))


def hang(scene: Scene, pictures: Pictures, rng: np.random.Generator) -> Scene:
    """The scene with pictures as the textures of some surfaces, never of a `backdrop`; geometry, light and motion
    stay. Its facts name the pictures, their folder and licence."""
    used: list[str] = []

    def papered(o: Object) -> Object:
        can = o.mesh is not None and o.material.kind != "glass" and o.emission is None and o.name != "backdrop"
        if not can or rng.uniform() >= PICTURE_SHARE:
            return o
        name = pictures.names[rng.integers(len(pictures.names))]
        used.append(name)
        texture = pictures.texture(name, rng)
        if o.material.kind == "metal":
            texture = np.clip(texture + 0.3, 0, 0.95)
        return replace(o, material=Material(texture, o.material.kind, o.material.roughness))

    objects = tuple(papered(o) for o in scene.objects)
    facts = {"pictures": {"folder": pictures.folder.name, "files": sorted(set(used)), "licence": pictures.licence}}
    return replace(scene, objects=objects, facts=scene.facts | facts)


@lru_cache(maxsize=32)
def _small(path: Path) -> np.ndarray:
    """`[H, W, 3]` uint8 sRGB; large pictures are reduced to less than 8 SIZE on their shorter side. Alpha is
    dropped."""
    with _opened(path) as image:
        return np.asarray(image.convert("RGB").reduce(max(1, min(image.size) // (4 * SIZE))))


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """A Pillow image. Raises InputError where the file cannot be read."""
    try:
        with open_regular(path) as content, Image.open(content) as image:
            yield image
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a readable picture: {error}; mend or remove it") from None
