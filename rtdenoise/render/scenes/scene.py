"""A scene as plain data: surfaces, materials, lights, motions and a camera. Needs no renderer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .meshes import Mesh
from .motions import Camera, Motion


@dataclass(frozen=True)
class Material:
    """One of a few kinds that all scenes share, so that the renderer's kernels are compiled once."""

    texture: np.ndarray  # [H, W, 3] reflectance
    kind: str = "diffuse"  # diffuse | plastic | metal | glass
    roughness: float = 0.3  # plastic, metal


@dataclass(frozen=True)
class Principled:
    """A physically based material with images, as asset libraries have them; row 0 is at v = 0."""

    color: np.ndarray  # [H, W, 3] reflectance
    roughness: np.ndarray  # [H, W, 1]
    metallic: np.ndarray  # [H, W, 1]
    normal: np.ndarray | None = None  # [H, W, 3] tangent-space normals, halved and offset into [0, 1]
    alpha: np.ndarray | None = None  # [H, W, 1] opacity
    transmission: float = 0.0  # share of light that is refracted, in [0, 1]
    ior: float = 1.5


@dataclass(frozen=True)
class Object:
    """A surface with an identity of its own."""

    id: int  # ≥ 1
    name: str
    mesh: Mesh | None = None  # at rest, in world space
    material: Material | Principled | None = None
    emission: tuple[float, float, float] | np.ndarray | None = None  # radiance on the side of the normals, or a texture
    motion: Motion | None = None  # None: does not move
    shapes: tuple[str, ...] = ()  # instead of mesh and material: ids of the shapes of a Mitsuba file


@dataclass(frozen=True)
class Spot:
    """A spot light: a cone of light from a point, soft towards its edge."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    intensity: tuple[float, float, float]  # radiant intensity on the axis
    angle: float = 30.0  # degrees between the axis and darkness


@dataclass(frozen=True)
class Sun:
    """Parallel light from one direction; the sun itself is invisible."""

    towards: tuple[float, float, float]  # unit vector to the sun
    irradiance: tuple[float, float, float]  # of a surface that faces it
    weight: float = 1.0  # how often it is sampled, relative to any other light


@dataclass(frozen=True)
class Scene:
    """Everything a renderer needs. Frame numbers are the times at which `camera` and the motions are evaluated."""

    name: str
    objects: tuple[Object, ...]
    camera: Callable[[float], Camera]
    sky: np.ndarray | None = None  # [H, W, 3] latitude-longitude radiance; None: black
    exposure: float = 1.0  # factor on all radiance
    file: Path | None = None  # Mitsuba XML with surfaces and light; objects with a mesh are added
    spots: tuple[Spot, ...] = ()
    sun: Sun | None = None
    facts: dict = field(default_factory=dict)  # for the metadata of clips

    def seen_through(self, window: tuple[int, int, int, int]) -> Scene:
        """The scene whose camera shows this part of its picture alone (`Camera.window`)."""
        return replace(self, camera=lambda t: replace(self.camera(t), window=window))
