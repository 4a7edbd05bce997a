"""Triangle meshes made in numpy: the shapes of procedural scenes.

Every mesh carries vertex normals and texture coordinates, flat ones too: all objects are then of one kind, and the
renderer compiles its kernels once for all scenes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """A closed surface has outward normals; faces turn the same way as their normals."""

    vertices: np.ndarray  # [V, 3] float32
    normals: np.ndarray  # [V, 3] float32, unit length
    uv: np.ndarray  # [V, 2] float32, textures repeat with period 1
    faces: np.ndarray  # [F, 3] uint32

    def transform(self, matrix: np.ndarray) -> Mesh:
        """Moved by a 4×4 matrix of rotation, translation and scale, without reflection."""
        normals = self.normals @ np.linalg.inv(matrix[:3, :3])
        return Mesh(
            (self.vertices @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32),
            (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
            self.uv,
            self.faces,
        )

    def scale_uv(self, factor: float) -> Mesh:
        return Mesh(self.vertices, self.normals, (self.uv * factor).astype(np.float32), self.faces)

    def flip(self) -> Mesh:
        """With the other side out."""
        return Mesh(self.vertices, -self.normals, self.uv, np.ascontiguousarray(self.faces[:, ::-1]))

    @property
    def radius(self) -> float:
        """Of the sphere about the origin that contains it."""
        return float(np.linalg.norm(self.vertices, axis=1).max())


def merge(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one object."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uv for m in meshes]),
        np.concatenate([m.faces + np.uint32(s) for m, s in zip(meshes, starts, strict=True)]),
    )


def quad(corner, edge_u, edge_v) -> Mesh:
    """Parallelogram corner + u·edge_u + v·edge_v with normal edge_u × edge_v; one texture period a unit of length."""
    corner, edge_u, edge_v = (np.asarray(a, np.float32) for a in (corner, edge_u, edge_v))
    lengths = np.linalg.norm(edge_u), np.linalg.norm(edge_v)
    normal = np.cross(edge_u, edge_v)
    return Mesh(
        np.stack([corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v]),
        np.tile(normal / np.linalg.norm(normal), (4, 1)).astype(np.float32),
        np.array([[0, 0], [lengths[0], 0], [lengths[0], lengths[1]], [0, lengths[1]]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
    )


def box(half) -> Mesh:
    """Axis-aligned box about the origin with half extents (x, y, z)."""
    half = np.asarray(half, np.float32)
    sides = []
    for axis in range(3):
        u, v, w = (np.eye(3, dtype=np.float32)[(axis + k) % 3] * 2 * half[(axis + k) % 3] for k in (1, 2, 0))
        sides += [quad((w - u - v) / 2, u, v), quad((-w - u - v) / 2, v, u)]
    return merge(sides)


def surface(function, steps_u: int, steps_v: int) -> Mesh:
    """The mesh of a parametric surface (u, v) in [0, 1]² → points [..., 3], with smooth normals, oriented outwards."""
    u, v = np.meshgrid(np.linspace(0, 1, steps_u + 1), np.linspace(0, 1, steps_v + 1), indexing="ij")
    e = 1e-3
    inner = np.clip(v, 2 * e, 1 - 2 * e)  # at a pole the derivative along u vanishes; beside it there is a normal
    normal = np.cross(function(u + e, inner) - function(u - e, inner), function(u, inner + e) - function(u, inner - e))
    normal = normal.reshape(-1, 3) / np.maximum(np.linalg.norm(normal.reshape(-1, 3), axis=1, keepdims=True), 1e-12)
    vertices = function(u, v).reshape(-1, 3)
    index = np.arange(vertices.shape[0], dtype=np.uint32).reshape(u.shape)
    a, b, c, d = (s.ravel() for s in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    uv = np.stack([u, v], -1).reshape(-1, 2)
    mesh = Mesh(vertices.astype(np.float32), normal.astype(np.float32), uv.astype(np.float32), faces)
    corners = vertices[faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return mesh if volume > 0 else mesh.flip()


def sphere(radius: float = 1.0, bumps: np.random.Generator | None = None, amount: float = 0.0) -> Mesh:
    """A sphere; with `bumps`, its radius is displaced by smooth random waves of relative height `amount`."""
    waves = bumps.normal(size=(6, 3)) * 3.0 if bumps is not None else np.zeros((0, 3))
    phases = bumps.uniform(0, 2 * np.pi, 6) if bumps is not None else np.zeros(0)

    def point(u, v):
        theta, phi = np.pi * v, 2 * np.pi * u
        d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1)
        r = 1 + amount / 2 * np.sin(d @ waves.T + phases).sum(-1) / np.sqrt(max(len(waves), 1))
        return radius * d * r[..., None]

    return surface(point, 40, 24)


def torus(radius: float = 1.0, tube: float = 0.35) -> Mesh:
    """Ring in the xz plane."""

    def point(u, v):
        a, b = 2 * np.pi * u, 2 * np.pi * v
        r = radius + tube * np.cos(b)
        return np.stack([r * np.cos(a), tube * np.sin(b), r * np.sin(a)], -1)

    return surface(point, 44, 20)


def disc(radius: float, height: float) -> Mesh:
    """Flat cap of 40 sides at y = height, facing up for height ≥ 0 and down below."""
    sides = 40
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False) * (-1 if height >= 0 else 1)
    rim = np.stack([np.cos(angle), np.zeros(sides), np.sin(angle)], 1)
    vertices = np.concatenate([[[0, 0, 0]], rim]) * radius + [0, height, 0]
    k = np.arange(sides)
    return Mesh(
        vertices.astype(np.float32),
        np.tile([0, 1 if height >= 0 else -1, 0], (sides + 1, 1)).astype(np.float32),
        (vertices[:, [0, 2]] / (2 * radius) + 0.5).astype(np.float32),
        np.stack([np.zeros(sides, int), k + 1, (k + 1) % sides + 1], 1).astype(np.uint32),
    )


def cylinder(radius: float = 1.0, half_height: float = 1.0) -> Mesh:
    """Upright, closed."""

    def point(u, v):
        a = 2 * np.pi * u
        return np.stack([radius * np.cos(a), half_height * (2 * v - 1), radius * np.sin(a)], -1)

    return merge([surface(point, 40, 1), disc(radius, half_height), disc(radius, -half_height)])


def prism(radius: float, half_height: float, sides: int, twist: float) -> Mesh:
    """An upright rounded prism whose cross section turns by `twist` radians from bottom to top."""

    def point(u, v):
        a = 2 * np.pi * u
        r = radius * (1 + 0.18 * np.cos(sides * a))
        turned = a + twist * v
        return np.stack([r * np.cos(turned), half_height * (2 * v - 1), r * np.sin(turned)], -1)

    top, bottom = disc(0.85 * radius, half_height), disc(0.85 * radius, -half_height)
    return merge([surface(point, 60, 16), top, bottom])


def bars(width: float, height: float, count: int, thickness: float, horizontal: bool = False) -> Mesh:
    """A fence (or, horizontal, blinds) of `count` thin bars in the xy plane about the origin."""
    parts = []
    for offset in (np.arange(count) + 0.5) / count - 0.5:
        half = (width / 2, thickness / 2, thickness / 2) if horizontal else (thickness / 2, height / 2, thickness / 2)
        matrix = np.eye(4)
        matrix[:2, 3] = (0, offset * height) if horizontal else (offset * width, 0)
        parts.append(box(half).transform(matrix))
    return merge(parts)
