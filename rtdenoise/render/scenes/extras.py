"""Objects added to a scene file: simple shapes, placed in free space."""

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
MAX_TRIES = 200
MAX_DISTANCE = 30.0  # units in front of the camera


def first_hits(scene, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """[N] distances to the first hits of rays in a Mitsuba scene, from [N, 3] along unit [N, 3]; inf: no hit."""
    mi = start_mitsuba()
    rays = mi.Ray3f(mi.Point3f(*np.float32(origins).T), mi.Vector3f(*np.float32(directions).T))
    distance = np.array(scene.ray_intersect_preliminary(rays).t, np.float64)
    return np.where(np.isfinite(distance), distance, np.inf)


def shapes_in_view(scene, camera: Camera) -> int:
    """How many different shapes of a Mitsuba scene a camera sees through a grid of 32 × 18 pixels."""
    mi = start_mitsuba()
    import drjit as dr

    origin, matrix = camera.world_from_pixel((18, 32))
    x, y = np.meshgrid(np.arange(32) + 0.5, np.arange(18) + 0.5)
    directions = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], 1) @ matrix.T
    origins = np.broadcast_to(np.float32(origin), directions.shape)
    rays = mi.Ray3f(mi.Point3f(*np.float32(origins).T), dr.normalize(mi.Vector3f(*np.float32(directions).T)))
    hits = scene.ray_intersect_preliminary(rays)
    return len(np.unique(np.array(dr.select(hits.is_valid(), dr.reinterpret_array(mi.UInt32, hits.shape), 0))))


def room_for(scene, mesh: Mesh, place) -> float:
    """Factor by which a mesh at `place` could grow before it touches the scene; below 1 it intersects it.

    Rays from its middle to its vertices measure it: the smallest ratio of the distance of a hit to that of the vertex.
    Thin geometry between the vertices goes unnoticed.
    """
    vertices = mesh.vertices[:: max(len(mesh.vertices) // 500, 1)].astype(np.float64)
    length = np.linalg.norm(vertices, axis=1)
    vertices, length = vertices[length > 0], length[length > 0]
    hits = first_hits(scene, np.broadcast_to(place, vertices.shape), vertices / length[:, None])
    return float((hits / length).min())


def free_place(scene, camera: Camera, mesh: Mesh, rng: np.random.Generator) -> np.ndarray | None:
    """A point [3] in view of the camera where the mesh touches nothing, with a tenth to spare; None: none was found.

    It lies between the camera and a visible surface, at 0.25 to 0.85 of the way: such points are never inside an
    object.
    """
    origin, matrix = camera.world_from_pixel((100, 100))
    pixels = np.concatenate([rng.uniform(15, 85, (MAX_TRIES, 2)), np.ones((MAX_TRIES, 1))], 1)
    directions = pixels @ matrix.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ways = np.minimum(first_hits(scene, np.broadcast_to(origin, directions.shape), directions), MAX_DISTANCE)
    for way, direction, share in zip(ways, directions, rng.uniform(0.25, 0.85, MAX_TRIES), strict=True):
        place = origin + direction * way * share
        if way * share > 1.5 * mesh.radius and room_for(scene, mesh, place) > 1.1:
            return place
    return None
