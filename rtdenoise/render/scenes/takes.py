"""Cameras and motions for a scene that is loaded already: several takes of one composition or scene file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .composed import Composition
from .extras import first_hits, shapes_in_view
from .motions import CameraPath, Keyframes, Motion
from .placing import Thing
from .procedural import log_uniform
from .scene import Scene

MAX_TRIES = 80
CANDIDATES = 6  # cameras of a scene file, of which one is taken
MIN_CLEARANCE = 0.12  # of the distance to the subject: nothing is nearer to the camera
MIN_SIGHT = 0.6  # share of the way to the subject that is free
MAX_PITCH = 40.0  # degrees that a camera looks down
CAMERA_SPEED = (0.4, 14)  # pixels a frame
OBJECT_SPEED = (1, 20)
PASSING_SHARE = 0.45  # of the takes, in which something crosses the view near the camera
BLURRED_SHARE = 0.12  # of the takes, with depth of field


@dataclass(frozen=True)
class View:
    """A camera path and what it looks at."""

    path: CameraPath
    distance: float  # to the subject
    pixel: float  # degrees of a pixel

    def step(self, pixels: float, distance: float) -> float:
        """Length in the scene of so many pixels at a distance from the camera."""
        return pixels * distance * np.radians(self.pixel)

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(right, down, forward) at the middle of the take."""
        matrix = self.path(self.path.start).to_world
        return matrix[:3, 0], matrix[:3, 1], matrix[:3, 2]


def compose_take(c: Composition, loaded, rng: np.random.Generator, frames: int, width: int) -> Scene | None:
    """The composition with a camera and motions for `frames` frames of pictures `width` pixels wide.

    `loaded` is its Mitsuba scene at rest. Returns None where no free place for a camera was found.
    """
    view = _find_view(c, loaded, rng, frames, width)
    if view is None:
        return None
    motions: dict[int, Motion] = {}
    count = int(rng.choice([0, 1, 2, 3], p=[0.2, 0.35, 0.25, 0.2]))
    for k in rng.permutation(len(c.movers))[:count]:
        thing = c.movers[k]
        motions |= dict.fromkeys(thing.ids, _move(thing, view, rng))
    if c.parked and rng.uniform() < PASSING_SHARE:
        thing = c.parked[int(rng.integers(len(c.parked)))]
        if passing := _pass(thing, view, loaded, rng, frames):
            motions |= dict.fromkeys(thing.ids, passing)
    objects = tuple(replace(o, motion=motions.get(o.id)) for o in c.scene.objects)
    return replace(c.scene, camera=view.path, objects=objects)


def film_take(scene: Scene, loaded, rng: np.random.Generator, frames: int, width: int) -> Scene:
    """A scene file with another camera: the one of CANDIDATES near its own that sees most different shapes.

    The objects keep their motions, at other speeds. Where no free place is found, the camera stays where it was.
    """
    own = scene.camera(frames / 2)
    origin, forward = own.to_world[:3, 3], own.to_world[:3, 2]
    candidates = [CameraPath(tuple(origin), tuple(origin + forward), own.fov, (frames - 1) / 2)]
    _, matrix = own.world_from_pixel((100, 100))
    for _ in range(MAX_TRIES):
        direction = matrix @ (*rng.uniform(20, 80, 2), 1.0)
        direction /= np.linalg.norm(direction)
        distance = float(first_hits(loaded, origin[None], direction[None])[0])
        if not np.isfinite(distance):
            continue
        aim = origin + direction * distance
        place = (
            origin + rng.normal(size=3) * (0.15, 0.06, 0.15) * distance + forward * rng.uniform(-0.1, 0.4) * distance
        )
        if _free(loaded, place, aim, rng):
            fov = float(own.fov * rng.uniform(0.65, 1.15))
            candidates.append(replace(candidates[0], origin=tuple(place), target=tuple(aim), fov=fov))
        if len(candidates) > CANDIDATES:
            break
    path = max(candidates[1:] or candidates, key=lambda path: shapes_in_view(loaded, path(path.start)))
    distance = float(np.linalg.norm(np.subtract(path.target, path.origin)))
    camera = _camera_move(path, distance, path.fov / width, rng)
    objects = tuple(o if o.motion is None else replace(o, motion=_varied(o.motion, rng, frames)) for o in scene.objects)
    return replace(scene, camera=camera, objects=objects)


# --- cameras ----------------------------------------------------------------------------------------------------------


def _find_view(c: Composition, loaded, rng, frames: int, width: int) -> View | None:
    for _ in range(MAX_TRIES if c.things else 0):
        thing = c.things[int(rng.integers(len(c.things)))]
        aim = thing.centre + rng.uniform(-0.4, 0.4, 3) * thing.size
        distance = max(log_uniform(rng, *c.reach), 0.9 * thing.size.max())
        around, pitch = rng.uniform(0, 2 * np.pi), np.radians(MAX_PITCH * rng.uniform(-0.1, 1))
        out = np.array([np.sin(around) * np.cos(pitch), np.sin(pitch), np.cos(around) * np.cos(pitch)])
        place = aim + distance * out
        if (place < c.low).any() or (place > c.high).any() or not _free(loaded, place, aim, rng):
            continue
        fov = float(rng.uniform(*c.fov))
        path = CameraPath(tuple(place.tolist()), tuple(aim.tolist()), fov, (frames - 1) / 2)
        return View(_camera_move(path, distance, fov / width, rng), distance, fov / width)
    return None


def _free(loaded, place: np.ndarray, aim: np.ndarray, rng) -> bool:
    """Whether nothing is near `place`, and most of the way to `aim` is free."""
    distance = np.linalg.norm(aim - place)
    directions = np.concatenate([[(aim - place) / distance], rng.normal(size=(48, 3))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = first_hits(loaded, np.broadcast_to(place, directions.shape), directions)
    return hits[0] > MIN_SIGHT * distance and hits.min() > min(MIN_CLEARANCE * distance, 0.4)


def _camera_move(path: CameraPath, distance: float, pixel: float, rng) -> CameraPath:
    """The path with one kind of motion, and a lens in some."""
    kind = str(rng.choice(["still", "pan", "orbit", "dolly", "hand-held"], p=[0.28, 0.2, 0.2, 0.2, 0.12]))
    speed = float(log_uniform(rng, *CAMERA_SPEED) * rng.choice([-1, 1]) * pixel)  # degrees a frame
    if rng.uniform() < BLURRED_SHARE:
        path = replace(path, aperture=distance * log_uniform(rng, 0.004, 0.02), focus=float(distance))
    if kind == "pan":
        return replace(path, pan=speed)
    if kind == "orbit":
        return replace(path, orbit=float(np.clip(2 * speed, -2.5, 2.5)))
    if kind == "dolly":
        along = rng.normal(size=3) * (1, 0.25, 1)
        step = min(abs(np.radians(speed)) * distance, 0.03 * distance)
        return replace(path, velocity=tuple((along / np.linalg.norm(along) * step).tolist()))
    if kind == "hand-held":
        return replace(path, shake=abs(speed), seed=int(rng.integers(1 << 30)))
    return path


# --- objects ----------------------------------------------------------------------------------------------------------


def _move(thing: Thing, view: View, rng) -> Motion:
    """A thing goes where it faces if it can go by itself; others slide, swing or turn."""
    distance = float(np.linalg.norm(thing.centre - np.array(view.path.origin)))
    step = view.step(log_uniform(rng, *OBJECT_SPEED), distance)
    start, pivot = view.path.start, tuple(thing.centre.tolist())
    if thing.asset.tags & {"vehicle", "people", "animal"}:
        heading = np.radians(thing.heading)
        velocity = step * np.array([np.sin(heading), 0, np.cos(heading)])
        bounce = (0.0, 0.0, 0.0) if "vehicle" in thing.asset.tags else (0.0, 0.01 * float(thing.size[1]), 0.0)
        return Motion(pivot, start, tuple(velocity.tolist()), bounce, period=9.0, spin=float(rng.uniform(-1.5, 1.5)))
    around = rng.uniform(0, 2 * np.pi)
    along = step * np.array([np.sin(around), 0, np.cos(around)])
    kind = str(rng.choice(["slide", "swing", "turn"], p=[0.45, 0.25, 0.3]))
    if kind == "slide":
        return Motion(pivot, start, tuple(along.tolist()), spin=float(rng.uniform(-4, 4)))
    if kind == "swing":
        period = float(rng.uniform(14, 40))
        return Motion(pivot, start, swing=tuple((along * period / (2 * np.pi)).tolist()), period=period)
    turn = np.clip(np.degrees(step / max(float(thing.size.max()) / 2, 1e-3)), 0.5, 12)
    return Motion(pivot, start, spin=float(turn * rng.choice([-1, 1])))


def _pass(thing: Thing, view: View, loaded, rng, frames: int) -> Motion | None:
    """A parked thing flies across the view between the camera and the subject; None where there is no room."""
    right, down, forward = view.axes()
    half = np.tan(np.radians(view.path.fov) / 2)
    size = float(thing.size.max())
    for _ in range(8):
        distance = np.clip(size / (2 * half * rng.uniform(0.06, 0.3)), 0.25 * view.distance, 0.85 * view.distance)
        if size > 0.7 * 2 * half * distance:  # it would fill the view
            return None
        middle = np.array(view.path.origin) + forward * distance
        middle += half * distance * (right * rng.uniform(-0.5, 0.5) + down * rng.uniform(-0.25, 0.25))
        step = view.step(log_uniform(rng, 4, 22), distance)
        along = right * rng.choice([-1, 1]) + rng.normal(size=3) * 0.15
        along /= np.linalg.norm(along)
        way = step * frames / 2 + size / 2
        if first_hits(loaded, np.stack([middle, middle]), np.stack([along, -along])).min() > way:
            break
    else:
        return None
    reach, rest = frames / 2 + 3, thing.centre
    ends = [middle + along * step * t - rest for t in (-reach, reach)]
    times = (view.path.start - reach, view.path.start + reach)
    keys = Keyframes(times, tuple((*map(float, end), 0.0) for end in ends), hold=True)
    axis = rng.normal(size=3)
    spin = float(rng.uniform(-9, 9))
    return Motion(tuple(rest.tolist()), view.path.start, axis=tuple(axis.tolist()), spin=spin, keys=keys)


def _varied(motion: Motion, rng, frames: int) -> Motion:
    """The same motion at another speed, now and then backwards, with its rest pose in the middle of the take."""
    if motion.keys is not None:
        return motion
    factor = log_uniform(rng, 0.4, 2) * rng.choice([-1, 1])
    velocity = tuple(float(factor * v) for v in motion.velocity)
    return replace(
        motion, start=(frames - 1) / 2, velocity=velocity, spin=float(factor * motion.spin),
        orbit_speed=float(factor * motion.orbit_speed), period=float(motion.period / abs(factor)),
    )  # fmt: skip
