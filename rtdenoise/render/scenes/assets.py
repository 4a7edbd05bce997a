"""A library of assets by other people: a folder with models, environment maps and surface pictures.

`index.json` lists them; docs/reference/assets.md explains its keys. Assets have licences, and cards name authors.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from reprlib import repr as shown

import numpy as np
import torch
from PIL import Image

from ...color import srgb_decode
from ...data.exr import read_channels
from ...errors import InputError
from ...files import open_regular, read_bytes, read_json
from .meshes import Mesh
from .scene import Principled

KINDS = {"models": ("path", "category"), "hdris": ("file", "tags"), "textures": ("file", "kind")}  # file, class
PLY_VERTEX = ("x", "y", "z", "nx", "ny", "nz", "u", "v")
PALETTE_SCALE = 8  # enlargement of palettes, so that texture filtering keeps their colours apart


@dataclass(frozen=True)
class Asset:
    """One entry of the index."""

    name: str
    file: Path
    tags: frozenset[str]  # a model's category, a picture's kind, an environment map's tags
    licence: str  # "": unknown
    author: str
    source: str
    facts: dict = field(repr=False, compare=False)  # the entry itself

    @property
    def extent(self) -> np.ndarray:
        """A model's width, height and depth, [3], in its own unit."""
        low, high = self.facts["bbox"]
        return np.subtract(high, low)

    @property
    def in_metres(self) -> bool:
        return self.facts.get("unit") == "m"


@dataclass(frozen=True)
class ModelPart:
    """One surface of a model, in the model's space: base at y = 0, front towards +z."""

    mesh: Mesh
    material: Principled
    emission: np.ndarray | None  # [H, W, 3] radiance


@dataclass(frozen=True)
class Library:
    """The assets of a folder."""

    folder: Path
    models: tuple[Asset, ...]
    hdris: tuple[Asset, ...]
    textures: tuple[Asset, ...]


@lru_cache(maxsize=4)
def read_library(folder: str | Path, allow_unlicensed: bool = False) -> Library:
    """Read FOLDER/index.json. Raises InputError for a bad entry: paths outside the folder, no licence, missing keys."""
    folder = Path(folder)
    index = _read_json(folder / "index.json")
    assets, names = {}, set()
    for kind, (path_key, tag_key) in KINDS.items():
        entries = index.get(kind, [])
        if not isinstance(entries, list):
            raise InputError(f"{folder / 'index.json'}: expected '{kind}' to be a list, got {shown(entries)}")
        found = [_asset(folder, kind, e, path_key, tag_key, allow_unlicensed) for e in entries]
        assets[kind] = tuple(_renamed(asset, kind, names) for asset in found)
        if not assets[kind]:
            raise InputError(f"{folder / 'index.json'}: lists no {kind}; expected one or more")
    return Library(folder, **assets)


def _asset(folder: Path, kind: str, entry: object, path_key: str, tag_key: str, allow_unlicensed: bool) -> Asset:
    if not isinstance(entry, dict):
        raise InputError(f"{folder / 'index.json'}: {kind}: expected objects, got {shown(entry)}")
    where = f"{folder / 'index.json'}: {kind}: {entry.get('name', 'entry without a name')}"
    for key in ("name", path_key, tag_key, *(("bbox",) if kind == "models" else ())):
        if key not in entry:
            raise InputError(f"{where}: has no '{key}'")
    tags = [entry[tag_key]] if isinstance(entry[tag_key], str) else entry[tag_key]
    if not isinstance(tags, list) or not all(isinstance(tag, str) for tag in tags):
        raise InputError(f"{where}: {tag_key}: expected text or a list of it, got {shown(tags)}")
    if not isinstance(entry[path_key], str) or "\0" in entry[path_key]:
        raise InputError(f"{where}: {path_key}: expected a file name, got {shown(entry[path_key])}")
    if kind == "models" and not _is_box(entry["bbox"]):
        raise InputError(f"{where}: bbox: expected [[x, y, z], [x, y, z]], least and greatest, got "
                         f"{shown(entry['bbox'])}")  # fmt: skip
    file = folder / entry[path_key]
    if not file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{where}: {path_key} '{entry[path_key]}' lies outside the folder; copy the asset into it")
    if not entry.get("license") and not allow_unlicensed:
        raise InputError(f"{where}: has no 'license'; add it, or accept unknown ones with --allow-unlicensed")
    return Asset(
        str(entry["name"]), file, frozenset(tags),
        *(str(entry.get(key) or "") for key in ("license", "author", "source")), entry,
    )  # fmt: skip


def _renamed(asset: Asset, kind: str, taken: set[str]) -> Asset:
    """The asset with a name of its own: cards credit assets by name."""
    name = asset.name
    while name in taken:
        name = f"{name} ({kind[:-1]})"
    taken.add(name)
    return replace(asset, name=name)


def _is_box(value: object) -> bool:
    try:
        box = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    return box.shape == (2, 3) and bool(np.isfinite(box).all() and (box[0] <= box[1]).all() and (box[0] < box[1]).any())


def attribution(asset: Asset) -> dict[str, str]:
    """The facts about an asset that data cards carry."""
    return {"licence": asset.licence or "unknown", "author": asset.author or "unknown", "source": asset.source}


# --- files ------------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def load_model(asset: Asset) -> tuple[ModelPart, ...]:
    """The parts of a model. Raises InputError where one of its files cannot be read, or has no faces."""
    document, folder = _read_json(asset.file), asset.file.parent
    try:
        parts = tuple(_part(folder, part) for part in document["parts"])
        if not parts or not all(len(part.mesh.faces) for part in parts):
            raise InputError(f"{asset.file}: a part, or the model, has no faces")
        return parts
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{asset.file}: a part is not as expected: {error!r}") from error


def require_models(library: Library) -> None:
    """Raise InputError where no model can be loaded, as where a copy of the library lacks the meshes."""
    for asset in library.models:
        try:
            load_model(asset)
            return
        except InputError as error:
            problem = error
    raise InputError(f"{library.folder}: none of its {len(library.models)} models can be loaded: {problem}")


def _part(folder: Path, part: dict) -> ModelPart:
    palette = bool(part.get("palette"))
    alpha, emissive = part.get("alpha"), part.get("emissive")
    material = Principled(
        _texture(folder, part["base_color"], 3, palette=palette),
        _texture(folder, part.get("roughness", 0.5), 1, raw=True, palette=palette),
        _texture(folder, part.get("metallic", 0.0), 1, raw=True, palette=palette),
        _texture(folder, part["normal"], 3, raw=True) if part.get("normal") else None,
        _texture(folder, alpha["file"], 1, raw=True) if alpha else None,
        float(_amounts(part.get("transmission", 0.0))), float(_amounts(part.get("ior", 1.5))),
    )  # fmt: skip
    emission = None
    if emissive:
        value = emissive.get("rgb", emissive.get("file"))
        emission = _texture(folder, value, 3) * _amounts(emissive.get("scale", 1.0))
        _amounts(emission)
    return ModelPart(_read_ply(_inside(folder, part["ply"])), material, emission)


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{folder}: '{name}' lies outside the model's folder")
    return path


def _texture(folder: Path, value, channels: int, raw: bool = False, palette: bool = False) -> np.ndarray:
    """[H, W, C] float32 of a number, a linear colour or an image file; images are decoded from sRGB unless `raw`."""
    if not isinstance(value, str):
        return np.ones((4, 4, channels), np.float32) * _amounts(value)
    image = read_picture(_inside(folder, value), channels, raw)
    return image.repeat(PALETTE_SCALE, 0).repeat(PALETTE_SCALE, 1) if palette else image


def _amounts(value: object) -> np.ndarray:
    """The float32 of a number or of several. Raises ValueError unless all are finite and none is below zero."""
    numbers = np.asarray(value, np.float64)
    if not (numbers <= np.finfo(np.float32).max).all() or not (numbers >= 0).all():  # NaN is neither
        raise ValueError(f"expected finite numbers from 0 on, got {shown(value)}")
    return numbers.astype(np.float32)


def read_picture(path: Path, channels: int = 3, raw: bool = False) -> np.ndarray:
    """[H, W, C] float32 in [0, 1] of an 8-bit picture, decoded from sRGB unless `raw`. Raises InputError."""
    try:
        with open_regular(path) as content, Image.open(content) as file:
            image = np.asarray(file.convert("RGB" if channels == 3 else "L"), np.float32) / 255
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a readable picture: {error}") from error
    image = image.reshape(*image.shape[:2], channels)
    return image if raw else srgb_decode(torch.from_numpy(image)).numpy()


@lru_cache(maxsize=8)
def load_hdri(asset: Asset) -> np.ndarray:
    """[H, W, 3] latitude-longitude radiance of an environment map, an EXR file. Raises InputError."""
    channels = read_channels(asset.file, ["R", "G", "B"])
    image = np.stack([channels[name].astype(np.float32) for name in "RGB"], -1)
    image = np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).clip(0)
    if not image.any():
        raise InputError(f"{asset.file}: the environment map is black")
    return image


def _read_ply(path: Path) -> Mesh:
    """A binary little-endian PLY mesh of triangles, with `PLY_VERTEX` as the properties of a vertex."""
    header, _, body = read_bytes(path).partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii", "replace").splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line[:1] == ["element"] and line[2:] and line[2].isdecimal()}
    properties = [line[1:] for line in lines if line[:1] == ["property"]]
    wanted = [["float", name] for name in PLY_VERTEX] + [["list", "uchar", "int", "vertex_indices"]]
    fits = lines[:1] == [["ply"]] and ["format", "binary_little_endian", "1.0"] in lines and properties == wanted
    if not fits or counts.keys() != {"vertex", "face"}:
        raise InputError(f"{path}: not a readable PLY mesh: expected binary little-endian triangles with "
                         f"the vertex properties {' '.join(PLY_VERTEX)}")  # fmt: skip
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    size = 4 * len(PLY_VERTEX) * counts["vertex"]
    if len(body) != size + face.itemsize * counts["face"]:
        raise InputError(f"{path}: not a readable PLY mesh: {len(body)} bytes of data, expected "
                         f"{size + face.itemsize * counts['face']}")  # fmt: skip
    vertices = np.frombuffer(body[:size], "<f4").reshape(-1, len(PLY_VERTEX))
    faces = np.frombuffer(body[size:], face)["corners"].astype(np.uint32)
    if not np.isfinite(vertices).all() or (len(faces) and faces.max() >= len(vertices)):
        raise InputError(f"{path}: not a readable PLY mesh: values that are not finite, or corners without a vertex")
    return Mesh(*(np.ascontiguousarray(vertices[:, part]) for part in (slice(3), slice(3, 6), slice(6, 8))), faces)


def _read_json(path: Path) -> dict:
    document = read_json(path)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a JSON object")
    return document
