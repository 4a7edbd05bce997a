"""Cameras and transforms beside the frames: `scene.json`, or `camera_matrices.h` as BMFR's data set has it."""

from __future__ import annotations

import re
from pathlib import Path
from reprlib import repr

import numpy as np

from ..errors import InputError
from ..files import read_json, read_text
from .exr_format import ExrHeader

FORMAT = "rtdenoise-scene-1"
MAX_ID = 2**32 - 1  # what EXR's unsigned integers hold


def read_scene(path: Path, header: ExrHeader) -> dict | None:
    """The scene, checked, in the form of scene.json; None where there is no such file.

    Raises `InputError` for a file that cannot be read, and for the first value that does not fit: a scene for pictures
    of another size than those of `header`, a camera that is not one of perspective, an object's transform without an
    inverse, two entries for one frame.
    """
    if not path.exists():
        return None
    return _parse_matrices(path, read_text(path), header) if path.suffix == ".h" else _check(path, header)


def _parse_matrices(path: Path, text: str, header: ExrHeader) -> dict:
    """BMFR's C header. With M the matrix of a frame, (x, y, z, w) = (X, Y, Z, 1) M, and the point is at
    ((x/w + 1)/2 · W, (y/w + 1)/2 · H), y down. Frames count from 0."""
    match = re.search(r"camera_matrices\s*\[\w*\]\s*\[4\]\s*\[4\]\s*=\s*\{(.*?)\}\s*;", text, re.DOTALL)
    if not match:
        raise InputError(f"{path}: expected an array 'camera_matrices[…][4][4] = {{…}};', found none")
    values = [float(v) for v in re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", match[1])]
    if not values or len(values) % 16:
        raise InputError(f"{path}: camera_matrices holds {len(values)} numbers, expected 16 for each frame")
    W, H = header.width, header.height
    to_pixel = np.array([[W / 2, 0, 0, W / 2], [0, H / 2, 0, H / 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    frames = []
    for number, matrix in enumerate(np.reshape(values, (-1, 4, 4))):
        world_to_pixel = to_pixel @ matrix.T
        projection = world_to_pixel[[0, 1, 3]]
        if not _has_inverse(projection[:, :3]):
            raise InputError(f"{path}: the matrix of frame {number} is not that of a perspective camera")
        origin = -np.linalg.solve(projection[:, :3], projection[:, 3])  # the point where x, y and w are all 0
        frames.append({"number": number, "world_to_pixel": world_to_pixel.tolist(), "camera_origin": origin.tolist(),
                       "object_to_world": {}})  # fmt: skip
    return {"width": W, "height": H, "objects": {}, "frames": frames}


def _check(path: Path, header: ExrHeader) -> dict:
    scene = read_json(path)
    if (found := scene.get("format") if isinstance(scene, dict) else None) != FORMAT:
        raise InputError(f"{path}: format is {repr(found)}, expected '{FORMAT}'")
    width, height = scene.get("width"), scene.get("height")
    if (width, height) != (header.width, header.height):
        raise InputError(f"{path}: is for {repr(width)}×{repr(height)} pixels, {header.path.name} has "
                         f"{header.width}×{header.height}")  # fmt: skip
    objects, frames = scene.get("objects"), scene.get("frames")
    if not isinstance(objects, dict) or not all(map(_is_id, objects)) or not isinstance(frames, list):
        raise InputError(f"{path}: expected 'objects' (id -> name) and 'frames' (a list)")
    numbers = set()
    for index, entry in enumerate(frames):
        number = _check_frame(f"{path}: frames[{index}]", entry)
        if number in numbers:
            raise InputError(f"{path}: frames[{index}]: number {number} is there twice")
        numbers.add(number)
    return scene


def _check_frame(label: str, entry: object) -> int:
    """Check one of the scene's frames; its number."""
    if not isinstance(entry, dict) or not _is_integer(entry.get("number")):
        raise InputError(f"{label}: expected an object with an integer 'number'")
    if not _is_integer(entry.get("shot", 0)):
        raise InputError(f"{label}: shot is {repr(entry['shot'])}, expected an integer")
    transforms = entry.get("object_to_world")
    if not isinstance(transforms, dict) or not all(map(_is_id, transforms)):
        raise InputError(f"{label}: expected 'object_to_world' to map object ids to 4×4 matrices")
    camera = _numbers(label, "world_to_pixel", entry.get("world_to_pixel"), (4, 4))
    _numbers(label, "camera_origin", entry.get("camera_origin"), (3,))
    # The row for depth plays no part in the picture.
    matrices = {"world_to_pixel": camera[[0, 1, 3], :3]}
    for key, transform in transforms.items():
        name = f"object_to_world[{key}]"
        matrices[name] = _numbers(label, name, transform, (4, 4))
    for name, matrix in matrices.items():
        if not _has_inverse(matrix):
            raise InputError(f"{label}: '{name}' cannot be inverted; expected a perspective camera and solid objects")
    return entry["number"]


def _numbers(label: str, name: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """Nested lists of numbers as a float64 array."""
    rows = value if len(shape) == 2 and isinstance(value, list) else [value]
    fits = len(rows) == (shape[0] if len(shape) == 2 else 1) and all(
        isinstance(row, list) and len(row) == shape[-1] and all(type(number) in (int, float) for number in row)
        for row in rows
    )
    try:
        array = np.array(value if fits else [], np.float64)
    except OverflowError:  # an integer of hundreds of digits
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{label}: expected '{name}' as {'×'.join(map(str, shape))} finite numbers")
    return array


def _is_integer(value: object) -> bool:
    """Whether it is an integer that fits 64 bits."""
    return type(value) is int and abs(value) < 2**63


def _is_id(key: str) -> bool:
    return key.isdecimal() and len(key) <= 10 and int(key) <= MAX_ID


def _has_inverse(matrix: np.ndarray) -> bool:
    try:
        return bool(np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix) == len(matrix))
    except np.linalg.LinAlgError:
        return False
