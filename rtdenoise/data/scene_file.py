"""Cameras and transforms beside the frames: `scene.json`, or `camera_matrices.h` as BMFR's data set has it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from .exr_format import ExrHeader


def read_scene(path: Path, header: ExrHeader) -> dict | None:
    """The scene, checked, in the form of scene.json; None where there is no such file. Raises `InputError`."""
    try:
        text = path.read_text()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read: not a text file") from None
    return _parse_matrices(path, text, header) if path.suffix == ".h" else _parse_scene(path, text, header)


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
        if np.linalg.matrix_rank(projection[:, :3]) < 3:
            raise InputError(f"{path}: the matrix of frame {number} is not that of a perspective camera")
        origin = -np.linalg.solve(projection[:, :3], projection[:, 3])  # the one point that x, y and w are all 0 for
        frames.append({"number": number, "world_to_pixel": world_to_pixel.tolist(), "camera_origin": origin.tolist(),
                       "object_to_world": {}})  # fmt: skip
    return {"width": W, "height": H, "objects": {}, "frames": frames}


def _parse_scene(path: Path, text: str, header: ExrHeader) -> dict:
    try:
        scene = json.loads(text)
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    if (found := scene.get("format") if isinstance(scene, dict) else None) != "rtdenoise-scene-1":
        raise InputError(f"{path}: format is {found!r}, expected 'rtdenoise-scene-1'")
    if (scene.get("width"), scene.get("height")) != (header.width, header.height):
        raise InputError(f"{path}: is for {scene.get('width')}×{scene.get('height')} pixels, "
                         f"{header.path.name} has {header.width}×{header.height}")  # fmt: skip
    if not isinstance(scene.get("objects"), dict) or not isinstance(scene.get("frames"), list):
        raise InputError(f"{path}: expected 'objects' (id -> name) and 'frames' (a list)")
    for index, entry in enumerate(scene["frames"]):
        _check_scene_frame(path, index, entry)
    return scene


def _check_scene_frame(path: Path, index: int, entry: dict) -> None:
    label = f"{path}: frames[{index}]"
    if not isinstance(entry, dict) or not isinstance(entry.get("number"), int):
        raise InputError(f"{label}: expected an object with an integer 'number'")
    transforms = entry.get("object_to_world")
    if not isinstance(transforms, dict) or not all(key.isdecimal() for key in transforms):
        raise InputError(f"{label}: expected 'object_to_world' to map object ids to 4×4 matrices")
    arrays = {"world_to_pixel": (4, 4), "camera_origin": (3,)}
    values = [(name, entry.get(name), shape) for name, shape in arrays.items()]
    for name, value, shape in values + [(f"object_to_world[{key}]", m, (4, 4)) for key, m in transforms.items()]:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{label}: expected '{name}' as {'×'.join(map(str, shape))} finite numbers")
        # A picture is made by the rows x, y and w; the one for depth plays no part.
        square = array[[0, 1, 3], :3] if name == "world_to_pixel" else array
        if len(shape) == 2 and np.linalg.matrix_rank(square) < len(square):
            raise InputError(f"{label}: '{name}' cannot be inverted; expected a perspective camera and solid objects")
