"""Furnish a scene with models of a library: choose, scale, turn and place them on free ground."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...errors import InputError
from .assets import Asset, Library, ModelPart, attribution, load_hdri, load_model, read_picture
from .meshes import Mesh, quad
from .motions import rigid, rotation
from .procedural import log_uniform
from .scene import Object, Principled

LONGEST = {  # metres of the longest side of models whose unit is unknown, by category
    "animal": 0.9, "bathroom": 0.2, "building": 9.0, "clothing": 0.5, "electronics": 0.3, "food": 0.2, "furniture": 1.2,
    "instrument": 1.0, "kitchen": 0.25, "lamp": 0.9, "misc": 0.8, "outdoor": 1.5, "people": 1.75, "picture": 0.6,
    "plant": 1.2, "rock": 0.7, "statue": 0.8, "thin": 2.0, "tools": 0.7, "toy": 0.3, "vehicle": 4.3,
}  # fmt: skip
FLAT_TOP = 0.5  # least area of a flat top that carries things, as a share of the base's area
MAX_TRIES = 12


@dataclass(frozen=True)
class Thing:
    """A model that has been placed."""

    asset: Asset
    ids: tuple[int, ...]  # of its parts
    centre: np.ndarray  # [3], of its bounding box
    size: np.ndarray  # [3], of its turned bounding box
    heading: float  # degrees from +z, about +y
    top: float | None  # height of a flat top, in world space


class Composer:
    """Collects objects while random decisions are made; remembers used assets, and those that could not be loaded."""

    def __init__(self, library: Library, rng: np.random.Generator):
        self.library, self.rng = library, rng
        self.objects: list[Object] = []
        self.things: list[Thing] = []
        self.used: dict[str, dict] = {}
        self.skipped: dict[str, str] = {}
        self._taken: list[tuple[float, float, float, float]] = []  # on the ground: x, z, half sizes

    def add(self, name: str, mesh: Mesh, material: Principled, **more) -> int:
        self.objects.append(Object(len(self.objects) + 1, name, mesh, material, **more))
        return len(self.objects)

    # --- surfaces and light -------------------------------------------------------------------------------------------

    def surface(self, *kinds: str, roughness: tuple[float, float] = (0.3, 0.9), tint: bool = False) -> Principled:
        """A material with a picture of one of these kinds (of any kind where the library has none)."""
        rng, assets = self.rng, self.library.textures
        fitting = [a for a in assets if a.tags & set(kinds) and a.facts.get("tileable")]
        image = self._load(lambda asset: _picture(asset), fitting, assets)
        if tint:
            image = image * rng.uniform(0.45, 1.0, 3).astype(np.float32)
        metal = 1.0 if "metal" in kinds and rng.uniform() < 0.7 else 0.0
        return Principled(np.clip(image, 0.02, 0.9), _plane(log_uniform(rng, *roughness)), _plane(metal))

    def sky(self, *tags: str) -> np.ndarray:
        """An environment map with one of these tags, turned about the vertical."""
        image = self._load(load_hdri, [a for a in self.library.hdris if a.tags & set(tags)], self.library.hdris)
        return np.roll(image, int(self.rng.integers(image.shape[1])), 1)

    def light(self, mesh: Mesh, strength: float, tint: float = 0.35) -> int:
        """A lamp that reflects nothing."""
        colour = 1 - self.rng.uniform(0, tint) * np.array([0.0, 0.45, 1.0])  # from white to warm
        return self.add("lamp", mesh, plain(0.0), emission=tuple((strength * colour).tolist()))

    def picture(self, corner, right, up) -> None:
        """A picture in a parallelogram, where the library has one."""
        assets = [a for a in self.library.textures if a.tags & {"painting", "poster", "text"}]
        with suppress(InputError):
            image = self._load(lambda asset: _picture(asset), assets)
            mesh = quad(corner, right, up)
            uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
            material = Principled(image, _plane(self.rng.uniform(0.1, 0.6)), _plane(0.0))
            self.add("picture", Mesh(mesh.vertices, mesh.normals, uv, mesh.faces), material)

    # --- models -------------------------------------------------------------------------------------------------------

    def choose(self, *categories: str, longest: tuple[float, float] = (0.0, 1e9), word: str = "") -> Asset | None:
        """A model of these categories whose longest side, in metres, is in this range; its name contains `word`."""
        fitting = [
            a for a in self.library.models
            if a.tags & set(categories) and a.name not in self.skipped and word in a.name
            and longest[0] <= metres(a).max() <= longest[1]
        ]  # fmt: skip
        while fitting:
            asset = fitting.pop(int(self.rng.integers(len(fitting))))
            try:
                load_model(asset)
            except InputError as error:
                self.skipped[asset.name] = str(error)
                continue
            return asset
        return None

    def put(
        self,
        asset: Asset | None,
        place,
        heading: float,
        *,
        scale: float = 1.0,
        claim: bool = True,
        margin: float = 0.03,
    ) -> Thing | None:
        """Place a model's base at `place` [3], its front turned by `heading` degrees from +z towards +x.

        Returns None, and places nothing, without a model or, with `claim`, if the place is taken.
        """
        if asset is None:
            return None
        scale = scale * metres(asset).max() / asset.extent.max()
        low, high = (np.array(v) * scale for v in asset.facts["bbox"])
        turn = rotation((0, 1, 0), heading)
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        corners = corners @ turn.T
        place = np.asarray(place, float) - [0, corners[:, 1].min(), 0]
        half = np.ptp(corners, axis=0) / 2
        middle = place + (corners.min(0) + corners.max(0)) / 2
        if claim and not self.claim(middle[0], middle[2], half[0] + margin, half[2] + margin):
            return None
        matrix = rigid(turn * scale, place)
        parts, ids = load_model(asset), []
        for part in parts:
            emission = None if part.emission is None else part.emission * np.float32(self.rng.uniform(2, 10))
            ids.append(self.add(asset.name, part.mesh.transform(matrix), part.material, emission=emission))
        self.used[asset.name] = attribution(asset)
        top = middle[1] + half[1] if _flat_top(parts) > FLAT_TOP else None
        thing = Thing(asset, tuple(ids), middle, 2 * half, heading, top)
        self.things.append(thing)
        return thing

    def claim(self, x: float, z: float, half_x: float, half_z: float) -> bool:
        """Reserve a rectangle of the ground; False, and nothing is reserved, where it overlaps another."""
        if any(abs(x - u) < half_x + a and abs(z - v) < half_z + b for u, v, a, b in self._taken):
            return False
        self._taken.append((x, z, half_x, half_z))
        return True

    def scatter(self, count: int, low, high, *categories: str, y: float = 0.0, **choice) -> list[Thing]:
        """Put up to `count` models anywhere in a rectangle of the ground, from `low` to `high` (x, z), unless full."""
        things = []
        for _ in range(count):
            asset = self.choose(*categories, **choice)
            for _ in range(MAX_TRIES):
                x, z = self.rng.uniform(low, high)
                if thing := self.put(asset, (x, y, z), self.rng.uniform(0, 360)):
                    things.append(thing)
                    break
        return things

    def set_table(self, table: Thing, count: int, *categories: str, longest=(0.0, 0.45)) -> list[Thing]:
        """Put small models on a flat top."""
        if table.top is None:
            return []
        taken, self._taken = self._taken, []
        room = 0.5 * table.size[[0, 2]] - 0.12
        middle = table.centre[[0, 2]]
        things = []
        if room.min() > 0:
            low, high = middle - room, middle + room
            things = self.scatter(count, low, high, *categories, y=table.top + 1e-3, longest=longest)
        self._taken = taken
        return things

    def _load(self, load, *choices: Sequence[Asset]):
        """`load` of a random asset of the first choice, or of the next ones where all of that fail; assets that fail
        are remembered. Raises InputError if all fail."""
        for choice in choices:
            assets = [a for a in choice if a.name not in self.skipped]
            while assets:
                asset = assets.pop(int(self.rng.integers(len(assets))))
                try:
                    loaded = load(asset)
                except InputError as error:
                    self.skipped[asset.name] = str(error)
                    continue
                self.used[asset.name] = attribution(asset)
                return loaded
        raise InputError(f"{self.library.folder}: none of the assets of one kind can be loaded: "
                         f"{next(reversed(self.skipped.values()), '')}")  # fmt: skip


def metres(asset: Asset) -> np.ndarray:
    """[3] size of a model, with the usual size of its category, of several the first in `LONGEST`, where its unit is
    unknown."""
    if asset.in_metres:
        return asset.extent
    usual = next((longest for tag, longest in LONGEST.items() if tag in asset.tags), 1.0)  # a set has no order
    return asset.extent * (usual / asset.extent.max())


def plain(value: float | tuple[float, float, float], roughness: float = 0.5, metallic: float = 0.0) -> Principled:
    """A material without pictures."""
    return Principled(np.ones((4, 4, 3), np.float32) * np.float32(value), _plane(roughness), _plane(metallic))


def glass() -> Principled:
    return Principled(np.ones((4, 4, 3), np.float32), _plane(0.05), _plane(0.0), transmission=1.0)


def _plane(value: float) -> np.ndarray:
    return np.full((4, 4, 1), value, np.float32)


@lru_cache(maxsize=64)
def _picture(asset: Asset) -> np.ndarray:
    return read_picture(asset.file)


def _flat_top(parts: tuple[ModelPart, ...]) -> float:
    """Area of the faces that look up within 3 % of a model's height from its top, as a share of its base's area."""
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    low, high = vertices.min(0), vertices.max(0)
    area = 0.0
    for part in parts:
        corners = part.mesh.vertices[part.mesh.faces]
        up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1] / 2
        on_top = corners[:, :, 1].min(1) > high[1] - 0.03 * (high[1] - low[1])
        area += up[on_top & (up > 0)].sum()
    return float(area / max((high[0] - low[0]) * (high[2] - low[2]), 1e-9))
