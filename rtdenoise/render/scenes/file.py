"""Mitsuba XML scenes, set in motion by a TOML file. docs/use/scenes.md explains every key.

    brightness = 0.5              # mean luminance of lit surfaces; without it the file's radiance is kept

    [camera]
    sensor = 0                    # index of the file's sensor that it starts from
    distance = 4.0                # to the point that it looks at and orbits about
    velocity = [0.01, 0.0, 0.0]   # and pan, orbit, shake, start, seed: see `motions.CameraPath`

    [[cut]]                       # at this frame the camera jumps; further keys as in [camera]
    frame = 6
    sensor = 1

    [[object]]
    name = "taxi"
    shapes = ["mv_taxi_*"]        # ids of the file's shapes; * stands for anything
    pivot = [1.9, 0.0, -9.0]      # and velocity, swing, spin, keys, …: see `motions.Motion`

    [[extra]]                     # an object that the file does not have
    shape = "torus"               # sphere, box, cylinder, torus, blob
    size = 0.3                    # radius of the sphere about it
    at = [0.0, 1.0, -2.0]         # its middle at rest; without it, a free place in view

Shapes that no object names stand still, each as an object of its own.
"""

from __future__ import annotations

import tomllib
from dataclasses import fields
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from reprlib import repr as shown

import numpy as np

from ...errors import InputError
from ..stage import load_file, start_mitsuba
from .extras import SHAPES, free_place, room_for
from .motions import CameraPath, Keyframes, Motion, Shots, rigid
from .scene import Material, Object, Scene

MATERIALS = ("diffuse", "plastic", "metal", "glass")
MOTION_KEYS = {f.name for f in fields(Motion)} | {"hold"}
OBJECT_KEYS = {"name", "shapes"} | MOTION_KEYS
EXTRA_KEYS = {"name", "shape", "size", "at", "material", "colour", "roughness", "place_seed"} | MOTION_KEYS
CAMERA_KEYS = {"sensor", "distance", "hold"} | {f.name for f in fields(CameraPath)} - {"origin", "target", "fov"}
OBJECT_FRAME = {"offset": 3, "turn": 1}  # numbers in a keyframe of an object; 0 where left out
CAMERA_FRAME = {"origin": 3, "target": 3}  # numbers in a keyframe of a camera; both are needed
LARGEST = 1e9  # of any number
ABOVE_0 = {"brightness", "size", "period", "distance", "focus"}
FROM_0_TO_1 = {"colour", "roughness"}


def open_file(path: str | Path, motion: str | Path | None = None) -> Scene:
    """The scene of a Mitsuba XML file; everything stands still without a motion file."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such scene file")
    script = _read(Path(motion)) if motion else {}
    loaded = load_file(path)
    where = f"{motion or path}"
    objects = _objects(_tables(script, "object", where), [shape.id() for shape in loaded.shapes()], where)
    cuts = _tables(script, "cut", where)
    paths = [_camera(script.get("camera", {}), loaded, f"{where}: camera", CAMERA_KEYS)]
    paths += [_camera(cut, loaded, f"{where}: cut", CAMERA_KEYS | {"frame"}) for cut in cuts]
    frames = tuple(_number(cut, "frame", f"{where}: cut") for cut in cuts)
    if list(frames) != sorted(set(frames)):
        raise InputError(f"{where}: cuts must be in the order of their frames, found {list(frames)}")
    camera = Shots(tuple(paths), frames) if cuts else paths[0]
    for entry in _tables(script, "extra", where):
        objects = (*objects, _extra(entry, len(objects) + 1, loaded, paths[0], where))
    facts = {"brightness": float(_number(script, "brightness", where))} if "brightness" in script else {}
    return Scene(path.parent.name or path.stem, objects, camera, facts=facts, file=path)


def _read(path: Path) -> dict:
    try:
        script = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, or an integer of thousands of digits
        raise InputError(f"{path}: not valid TOML: {error}") from error
    _check(script, {"brightness", "camera", "cut", "object", "extra"}, f"{path}")
    return script


def _tables(table: dict, key: str, where: str) -> list[dict]:
    """The tables `[[key]]`."""
    found = table.get(key, [])
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise InputError(f"{where}: {key} = {found!r}: expected tables")
    return found


def _check(table: dict, known: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise InputError(f"{where} = {table!r}: expected a table")
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}'; expected one of {', '.join(sorted(known))}")


def _objects(entries: list[dict], shapes: list[str], where) -> tuple[Object, ...]:
    objects, left = [], dict.fromkeys(shapes)
    for entry in entries:
        name = _name(entry, "object", where)
        _check(entry, OBJECT_KEYS, f"{where}: object '{name}'")
        patterns = entry.get("shapes", [])
        if not isinstance(patterns, list) or not all(isinstance(pattern, str) for pattern in patterns):
            raise InputError(f"{where}: object '{name}': shapes = {patterns!r}: expected a list of names")
        own = tuple(s for s in left if any(fnmatchcase(s, pattern) for pattern in patterns))
        if not own:
            raise InputError(
                f"{where}: object '{name}': no shape of the scene matches {patterns}{_near(patterns, shapes)}"
            )
        for shape in own:
            del left[shape]
        motion = _motion(entry, f"{where}: object '{name}'")
        objects.append(Object(len(objects) + 1, name, shapes=own, motion=motion))
    return (*objects, *(Object(i, s, shapes=(s,)) for i, s in enumerate(left, len(objects) + 1)))


def _name(entry: dict, kind: str, where: str) -> str:
    """The name of an object, which scene.json repeats; `kind` without one."""
    name = entry.get("name", kind)
    if not isinstance(name, str):
        raise InputError(f"{where}: {kind}: name = {shown(name)}: expected text")
    return name


def _near(patterns: list[str], shapes: list[str]) -> str:
    """Similar names, as the end of a message."""
    stems = {pattern.replace("*", "") for pattern in patterns}
    near = []
    for stem in stems:
        starts = {shape[: len(stem)]: shape for shape in reversed(shapes)}  # * mostly stands at the end
        near += get_close_matches(stem, shapes, 3, 0.5) + [starts[s] for s in get_close_matches(stem, starts, 3)]
    names = list(dict.fromkeys(near))[:4] or shapes[:4]
    return f"; {'near' if near else 'it has'}: {', '.join(names)}"


def _motion(entry: dict, where: str) -> Motion:
    if "keys" not in entry:
        return Motion(**_arguments(Motion, entry, where))
    keys = _keyframes(entry, OBJECT_FRAME, where, {"offset": [0, 0, 0], "turn": 0})
    return Motion(**_arguments(Motion, entry, where), keys=keys)


def _keyframes(entry: dict, parts: dict[str, int], where: str, default: dict) -> Keyframes:
    """`keys = [{frame = 0, …}, …]`: every frame's parts as one row of numbers."""
    frames, rows = [], []
    for key in _tables(entry, "keys", where):
        _check(key, {"frame", *parts}, f"{where}: keys")
        frames.append(_number(key, "frame", f"{where}: keys"))
        row = []
        for name, count in parts.items():
            if name not in key and name not in default:
                raise InputError(f"{where}: keys: frame {frames[-1]:g} has no {name}")
            row += _numbers(key.get(name, default.get(name)), count, f"{where}: keys", name)
        rows.append(tuple(row))
    if not frames or frames != sorted(set(frames)):
        raise InputError(f"{where}: keys must be in the order of their frames, found {frames}")
    if not isinstance(hold := entry.get("hold", False), bool):
        raise InputError(f"{where}: hold = {hold!r}: expected true or false")
    return Keyframes(tuple(frames), tuple(rows), hold, where)


def _extra(entry: dict, id: int, loaded, path: CameraPath, where: str) -> Object:
    """An added object, placed where it touches nothing in frame 0."""
    name = _name(entry, "extra", where)
    where = f"{where}: extra '{name}'"
    _check(entry, EXTRA_KEYS, where)
    for key, known in (("shape", tuple(SHAPES)), ("material", MATERIALS)):
        if entry.get(key, known[0]) not in known:
            raise InputError(f"{where}: {key} '{entry[key]}'; expected one of {', '.join(known)}")
    mesh = SHAPES[entry.get("shape", "sphere")](_number(entry | {"size": entry.get("size", 0.25)}, "size", where))
    if "at" in entry:
        place = np.array(_numbers(entry["at"], 3, where, "at"))
        if (room := room_for(loaded, mesh, place)) < 1:
            raise InputError(f"{where}: at {entry['at']} it intersects the scene: {room:.0%} of its size are free")
    else:
        rng = np.random.default_rng(int(abs(_number({"place_seed": 0} | entry, "place_seed", where))))
        place = free_place(loaded, path(0), mesh, rng)
        if place is None:
            raise InputError(f"{where}: no free place of size {mesh.radius:g} was found in view; make it smaller")
    colour = _numbers(entry.get("colour", [0.6, 0.6, 0.6]), 3, where, "colour")
    texture = np.ones((4, 4, 3), np.float32) * np.float32(colour)
    roughness = float(_number({"roughness": 0.3} | entry, "roughness", where))
    material = Material(texture, entry.get("material", "diffuse"), roughness)
    motion = _motion({"pivot": place.tolist()} | entry, where)
    return Object(id, name, mesh.transform(rigid(np.eye(3), place)), material, motion=motion)


def _camera(entry: dict, loaded, where: str, known: set[str]) -> CameraPath:
    mi = start_mitsuba()
    _check(entry, known, where)
    sensors, index = loaded.sensors(), entry.get("sensor", 0)
    if type(index) is not int or not 0 <= index < len(sensors):
        raise InputError(f"{where}: sensor {index} asked for, the scene has {len(sensors)}")
    parameters = mi.traverse(sensors[index])
    if "x_fov" not in parameters:
        raise InputError(f"{where}: sensor {index} is no perspective camera")
    pose = np.array(sensors[index].world_transform().matrix, np.float64).reshape(4, 4)
    origin, forward = pose[:3, 3], pose[:3, 2] / np.linalg.norm(pose[:3, 2])
    target = origin + forward * _number({"distance": 4.0} | entry, "distance", where)
    fov = float(parameters["x_fov"][0])
    moves = _arguments(CameraPath, entry, where)
    if "keys" in entry:
        moves["keys"] = _keyframes(entry, CAMERA_FRAME, where, {})
    return CameraPath(tuple(origin.tolist()), tuple(target.tolist()), fov, **moves)


def _arguments(cls, entry: dict, where: str) -> dict:
    """The entries that are fields of `cls` (except `keys`), checked for their count of numbers."""
    arguments = {}
    for field in fields(cls):
        if field.name in entry and field.name != "keys":
            count = 3 if field.type == "Vector" else 1
            value = _numbers(entry[field.name], count, where, field.name)
            arguments[field.name] = tuple(map(float, value)) if count > 1 else value[0]
    return arguments


def _number(entry: dict, key: str, where: str) -> float:
    return _numbers(entry.get(key), 1, where, key)[0]


def _numbers(value, count: int, where: str, name: str) -> list:
    numbers, where = value if isinstance(value, list) else [value], f"{where}: {name}"
    if len(numbers) != count or not all(type(n) in (int, float) and abs(n) <= LARGEST for n in numbers):
        raise InputError(f"{where} = {value!r}: expected {count} number(s) of at most {LARGEST:g}")
    if name in ABOVE_0 and not all(n > 0 for n in numbers):
        raise InputError(f"{where} = {value!r}: expected more than 0")
    if name == "aperture" and numbers[0] < 0:
        raise InputError(f"{where} = {value!r}: expected 0 or more")
    if name in FROM_0_TO_1 and not all(0 <= n <= 1 for n in numbers):
        raise InputError(f"{where} = {value!r}: expected 0 to 1")
    if name == "seed" and not (isinstance(numbers[0], int) and numbers[0] >= 0):
        raise InputError(f"{where} = {value!r}: expected a whole number from 0 on")
    if name == "axis" and not any(numbers):
        raise InputError(f"{where} = {value!r}: expected a direction")
    return numbers
