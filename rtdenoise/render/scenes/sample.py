"""The scene of the bundled sample: a sunlit room that training never sees, with textures of its own.

The sun falls through a window onto the floor; light from there, the sky and a dim lamp light the rest. A torus, a
ball and a crate cross in front of a painted wall, 4 to 10 pixels a frame at 320×180, and uncover it again.
"""

from __future__ import annotations

import numpy as np

from . import meshes
from .motions import CameraPath, Motion
from .scene import Material, Object, Scene
from .textures import SKY, fractal

FRAMES = 12
MIDDLE = (FRAMES - 1) / 2


def _mural(rng: np.random.Generator) -> np.ndarray:
    """Truchet tiles: bands of quarter circles that join into random curves, painted on plaster."""
    cells, pixels = (14, 28), 40
    y, x = np.meshgrid(*(np.arange(n * pixels) for n in cells), indexing="ij")
    u, v = (x % pixels + 0.5) / pixels, (y % pixels + 0.5) / pixels
    flip = rng.uniform(size=cells)[y // pixels, x // pixels] < 0.5
    u = np.where(flip, 1 - u, u)
    distance = np.minimum(np.hypot(u, v), np.hypot(1 - u, 1 - v))
    band = np.abs(distance - 0.5)
    cream, navy, ochre = np.array([0.80, 0.74, 0.60]), np.array([0.05, 0.11, 0.24]), np.array([0.72, 0.36, 0.08])
    image = np.where((band < 0.16)[..., None], navy, cream)
    image = np.where((band < 0.045)[..., None], ochre, image)
    plaster = np.tile(fractal(rng, 8), (5, 9))[: image.shape[0], : image.shape[1], None]
    return (image * (0.85 + 0.15 * plaster)).astype(np.float32)


def _parquet(rng: np.random.Generator) -> np.ndarray:
    """Planks in staggered rows, each with a tone and a grain of its own."""
    rows, columns, pixels = 24, 6, 96
    y, x = np.meshgrid(np.arange(rows * 24), np.arange(columns * pixels), indexing="ij")
    shifted = x + (y // 24 * 37) % pixels
    tone = rng.uniform(0.65, 1.0, (rows, columns))[y // 24, shifted // pixels % columns]
    grain = np.tile(fractal(rng, 4), (5, 5))[(y * 2) % 640, (shifted // 6) % 640]
    joint = (y % 24 < 1) | (shifted % pixels < 1)
    wood = np.array([0.55, 0.33, 0.17]) * (tone * (0.75 + 0.25 * grain))[..., None]
    return np.where(joint[..., None], 0.06, wood).astype(np.float32)


def _rug() -> np.ndarray:
    """Concentric diamonds with a fringe of fine lines."""
    y, x = (np.mgrid[:240, :240] + 0.5) / 240 * 2 - 1
    ring = ((np.abs(x) + np.abs(y)) * 9).astype(int) % 3
    colours = np.array([[0.55, 0.07, 0.06], [0.78, 0.66, 0.45], [0.10, 0.12, 0.20]])
    edge = np.maximum(np.abs(x), np.abs(y)) > 0.9
    stripes = (np.arange(240) // 4 % 2)[None, :, None] * 0.5 + 0.15
    return np.where(edge[..., None], stripes, colours[ring]).astype(np.float32)


def _planks() -> np.ndarray:
    """A crate's side: boards, a frame and nails."""
    y, x = np.mgrid[:128, :128] / 128
    board = 0.55 + 0.25 * ((y * 5).astype(int) % 2) - 0.4 * ((y * 5 % 1) < 0.06)
    frame = (np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)) < 0.12) | (np.abs(x - y) < 0.07)
    image = np.where(frame[..., None], [0.62, 0.47, 0.28], board[..., None] * np.array([0.75, 0.55, 0.33]))
    return image.astype(np.float32)


def _at(mesh: meshes.Mesh, place, axis=(0.0, 1.0, 0.0), degrees: float = 0.0) -> meshes.Mesh:
    return mesh.transform(Motion(velocity=tuple(place), axis=axis, spin=degrees)(1.0))


def sample() -> Scene:
    """Twelve frames, 0 to 11, made for 320×180."""
    rng = np.random.default_rng([0x5A4D504C45])  # "SAMPLE": no integer seed of the procedural scenes
    objects: list[Object] = []

    def add(name, mesh, texture, kind="diffuse", roughness=0.3, **more):
        texture = np.asarray(texture, np.float32)
        texture = np.ones((8, 8, 3), np.float32) * texture if texture.ndim == 1 else texture
        objects.append(Object(len(objects) + 1, name, mesh, Material(texture, kind, roughness), **more))

    white, red, teal = np.array([0.78, 0.76, 0.72]), np.array([0.68, 0.12, 0.08]), np.array([0.10, 0.42, 0.40])
    floor = meshes.quad((-3, 0, 0.5), (6, 0, 0), (0, 0, -6.5))
    back = meshes.quad((-3, 0, -6), (6, 0, 0), (0, 3, 0))
    add("floor", floor.scale_uv(1 / 3), _parquet(rng))
    add("back wall", meshes.Mesh(back.vertices, back.normals, back.uv / np.float32([6, 3]), back.faces), _mural(rng))
    add("ceiling", meshes.quad((-3, 3, -6), (6, 0, 0), (0, 0, 6.5)), white)
    add("right wall", meshes.quad((3, 0, -6), (0, 0, 6.5), (0, 3, 0)), teal)
    add("front wall", meshes.quad((3, 0, 0.5), (-6, 0, 0), (0, 3, 0)), white)
    window = [((-3.1, 0.4, -2.75), (0.1, 0.4, 3.25)), ((-3.1, 2.75, -2.75), (0.1, 0.25, 3.25)),
              ((-3.1, 1.65, -5.2), (0.1, 0.85, 0.8)), ((-3.1, 1.65, -0.85), (0.1, 0.85, 1.35))]  # fmt: skip
    add("left wall", meshes.merge([_at(meshes.box(half), place) for place, half in window]), red)
    mullions = [((-3.1, 1.65, -3.3), (0.05, 0.85, 0.04)), ((-3.1, 1.65, -3.3), (0.05, 0.04, 1.1))]
    add("window frame", meshes.merge([_at(meshes.box(half), place) for place, half in mullions]), white)

    sun = meshes.quad((-0.8, 0, -0.8), (1.6, 0, 0), (0, 0, 1.6))  # faces down; turned towards the room
    add("sun", _at(sun, (-9.0, 6.2, -2.2), (0, 0, 1), 55), [0.2] * 3, emission=(150.0, 130.0, 98.0))
    lamp = meshes.quad((-1.8, 2.98, -1.5), (3.6, 0, 0), (0, 0, 1.2))
    add("lamp", lamp, [0.2] * 3, emission=(2.0, 1.85, 1.6))
    rug = meshes.quad((-1.5, 0.012, -2.6), (3, 0, 0), (0, 0, -2))
    add("rug", meshes.Mesh(rug.vertices, rug.normals, rug.uv / np.float32([3, 2]), rug.faces), _rug())
    add("pedestal", _at(meshes.box((0.3, 0.45, 0.3)), (1.9, 0.45, -4.9)), white)
    add("sculpture", _at(meshes.sphere(0.38, rng, 0.45), (1.9, 1.25, -4.9)), [0.85, 0.66, 0.35], "metal", 0.2)
    add("bench", _at(meshes.box((0.9, 0.06, 0.25)), (-1.4, 0.5, -5.3)), [0.4, 0.24, 0.12], "plastic", 0.25)
    legs = [_at(meshes.box((0.05, 0.22, 0.2)), (x, 0.22, -5.3)) for x in (-2.1, -0.7)]
    add("bench legs", meshes.merge(legs), [0.2, 0.12, 0.07])

    def across(place, velocity, **more):
        return Motion(pivot=place, start=MIDDLE, velocity=velocity, **more)

    place = (-0.75, 1.35, -3.0)
    ring = _at(meshes.torus(0.46, 0.17), place, (1, 0, 0), 68)
    motion = across(place, (0.085, 0.012, 0), axis=(0.3, 1, 0.2), spin=5)
    add("torus", ring, [0.85, 0.30, 0.05], "plastic", 0.2, motion=motion)
    place = (0.95, 0.55, -3.7)
    crate = _at(meshes.box((0.42, 0.42, 0.42)), place, (0, 1, 0), 25)
    add("crate", crate.scale_uv(1 / 0.84), _planks(), motion=across(place, (-0.09, 0, 0.01), spin=-2.0))
    place = (0.2, 2.05, -4.3)
    light = np.tile((np.arange(64) // 8 % 2 > 0)[:, None, None], (1, 64, 1))
    stripes = np.where(light, [0.82, 0.80, 0.76], [0.10, 0.30, 0.55])
    ball = _at(meshes.sphere(0.36), place)
    motion = across(place, (-0.07, 0, 0), swing=(0, 0.12, 0), period=16, axis=(0, 0, 1), spin=7)
    add("ball", ball, stripes, motion=motion)

    camera = CameraPath(
        (0.15, 1.45, 0.15), (0.0, 1.25, -4.5), fov=64, start=MIDDLE, velocity=(0.008, 0.001, -0.012), shake=0.12, seed=5
    )
    sky = np.ones((*SKY, 3), np.float32) * np.float32([0.45, 0.6, 0.85])
    return Scene("sample", tuple(objects), camera, sky, exposure=4.9)
