"""Objects added to a scene file: simple shapes, placed where nothing is in their way."""

from __future__ import annotations

import numpy as np

from ..stage import start_mitsuba
from . import meshes
from .meshes import Mesh
from .motions import Camera

SHAPES = {
    "sphere": lambda r: meshes.sphere(r),
    "box": lambda r: meshes.box((r / 3**0.5,) * 3),
    "cylinder": lambda r: meshes.cylinder(r / 2**0.5, r / 2**0.5),
    "torus": lambda r: meshes.torus(0.72 * r, 0.28 * r),
    "blob": lambda r: meshes.sphere(0.8 * r, np.random.default_rng(0), 0.4),
}  # radius of the sphere that contains it -> mesh about the origin
TRIES = 200
FARTHEST = 30.0  # units in front of the camera


def first_hits(scene, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[N] distances to what rays from origins [N, 3] along unit directions [N, 3] hit in a Mitsuba scene; inf: none."""
    mi = start_mitsuba()
    rays = mi.Ray3f(mi.Point3f(*np.float32(origins).T), mi.Vector3f(*np.float32(directions).T))
    distance = np.array(scene.ray_intersect_preliminary(rays).t, np.float64)
    return np.where(np.isfinite(distance), distance, np.inf)


def room_for(scene, mesh: Mesh, place) -> float:
    """How much of a mesh at `place` is free, 1 or more: all of it. Rays from its middle to its vertices say so: the
    least ratio of what they hit to where the vertex is. What passes between the vertices is not noticed."""
    vertices = mesh.vertices[:: max(len(mesh.vertices) // 500, 1)].astype(np.float64)
    length = np.linalg.norm(vertices, axis=1)
    vertices, length = vertices[length > 0], length[length > 0]
    hits = first_hits(scene, np.broadcast_to(place, vertices.shape), vertices / length[:, None])
    return float((hits / length).min())


def free_place(scene, camera: Camera, mesh: Mesh, rng: np.random.Generator, depth=(0.25, 0.85)) -> np.ndarray | None:
    """A point [3] in view of the camera where the mesh touches nothing, with a tenth to spare; None: none was found.

    It is on the line from the camera to what a pixel shows, at a share of the way that is within `depth`; points on it
    are never inside of anything.
    """
    origin, matrix = camera.world_from_pixel((100, 100))
    pixels = np.concatenate([rng.uniform(15, 85, (TRIES, 2)), np.ones((TRIES, 1))], 1)
    directions = pixels @ matrix.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ways = np.minimum(first_hits(scene, np.broadcast_to(origin, directions.shape), directions), FARTHEST)
    for way, direction, share in zip(ways, directions, rng.uniform(*depth, TRIES), strict=True):
        place = origin + direction * way * share
        if way * share > 1.5 * mesh.radius and room_for(scene, mesh, place) > 1.1:
            return place
    return None
