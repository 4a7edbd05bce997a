"""Mitsuba XML scenes, set in motion by a TOML file.

    brightness = 0.5              # mean luminance of what is lit; without it the file's radiance is kept

    [camera]
    sensor = 0                    # which of the file's sensors it starts from
    distance = 4.0                # to the point that it looks at and orbits about
    velocity = [0.01, 0.0, 0.0]   # and pan, orbit, shake, start, seed: see `motions.CameraPath`

    [[object]]
    name = "taxi"
    shapes = ["mv_taxi_*"]        # ids of the file's shapes; * stands for anything
    pivot = [1.9, 0.0, -9.0]      # and velocity, swing, spin, …: see `motions.Motion`

Shapes that no object names stand still, each as an object of its own.
"""

from __future__ import annotations

import tomllib
from dataclasses import fields
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from rtdenoise.data.motions import CameraPath, Motion
from rtdenoise.data.scenes import Object, Scene
from rtdenoise.data.stage import load_file, start_mitsuba
from rtdenoise.errors import InputError

OBJECT_KEYS = {"name", "shapes"} | {f.name for f in fields(Motion)}
CAMERA_KEYS = {"sensor", "distance"} | {f.name for f in fields(CameraPath)} - {"origin", "target", "fov"}


def open_file(path: str | Path, motion: str | Path | None = None) -> Scene:
    """The scene of a Mitsuba XML file; everything stands still without a motion file."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such scene file")
    script = _read(Path(motion)) if motion else {}
    loaded = load_file(path)
    objects = _objects(script.get("object", []), [shape.id() for shape in loaded.shapes()], motion)
    camera = _camera(script.get("camera", {}), loaded, f"{motion or path}")
    facts = {"brightness": float(script["brightness"])} if "brightness" in script else {}
    return Scene(path.parent.name or path.stem, objects, camera, facts=facts, file=path)


def _read(path: Path) -> dict:
    try:
        script = tomllib.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    _check(script, {"brightness", "camera", "object"}, f"{path}")
    return script


def _check(table: dict, known: set[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'; expected one of {', '.join(sorted(known))}")


def _objects(entries: list[dict], shapes: list[str], where) -> tuple[Object, ...]:
    objects, left = [], dict.fromkeys(shapes)
    for entry in entries:
        name = entry.get("name", "object")
        _check(entry, OBJECT_KEYS, f"{where}: object '{name}'")
        patterns = entry.get("shapes", [])
        own = tuple(s for s in left if any(fnmatchcase(s, pattern) for pattern in patterns))
        if not own:
            raise InputError(f"{where}: object '{name}': no shape of the scene matches {patterns}")
        for shape in own:
            del left[shape]
        motion = Motion(**_arguments(Motion, entry, f"{where}: object '{name}'"))
        objects.append(Object(len(objects) + 1, name, shapes=own, motion=motion))
    return (*objects, *(Object(i, s, shapes=(s,)) for i, s in enumerate(left, len(objects) + 1)))


def _camera(entry: dict, loaded, where: str) -> CameraPath:
    mi = start_mitsuba()
    _check(entry, CAMERA_KEYS, f"{where}: camera")
    sensors, index = loaded.sensors(), entry.get("sensor", 0)
    if not 0 <= index < len(sensors):
        raise InputError(f"{where}: sensor {index} asked for, the scene has {len(sensors)}")
    parameters = mi.traverse(sensors[index])
    if "x_fov" not in parameters:
        raise InputError(f"{where}: sensor {index} is no perspective camera")
    pose = np.array(sensors[index].world_transform().matrix, np.float64).reshape(4, 4)
    origin, forward = pose[:3, 3], pose[:3, 2] / np.linalg.norm(pose[:3, 2])
    target = origin + forward * entry.get("distance", 4.0)
    fov = float(parameters["x_fov"][0])
    moves = _arguments(CameraPath, entry, f"{where}: camera")
    return CameraPath(tuple(origin.tolist()), tuple(target.tolist()), fov, **moves)


def _arguments(cls, entry: dict, where: str) -> dict:
    """The entries that are fields of `cls`, each with as many numbers as the field takes."""
    arguments = {}
    for field in fields(cls):
        if field.name in entry:
            value, count = entry[field.name], 3 if field.type == "Vector" else 1
            numbers = value if isinstance(value, list) else [value]
            if len(numbers) != count or not all(isinstance(n, int | float) for n in numbers):
                raise InputError(f"{where}: {field.name} = {value!r}: expected {count} number(s)")
            arguments[field.name] = tuple(map(float, value)) if count > 1 else value
    return arguments
