"""Motions of objects and cameras: time in frames → 4×4 matrices. Plain data, so that a file can hold a motion.

World space is right-handed with +y up. Angles are in degrees, speeds in units (or degrees) per frame.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError

Vector = tuple[float, float, float]


def rotation(axis, degrees: float) -> np.ndarray:
    """[3, 3] right-handed rotation about `axis`."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    angle = np.radians(degrees)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def rigid(matrix: np.ndarray, offset) -> np.ndarray:
    """[4, 4] from a rotation and a translation."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = matrix, offset
    return result


@dataclass(frozen=True)
class Keyframes:
    """Values at given frames, straight lines between them."""

    frames: tuple[float, ...]  # ascending
    values: tuple[tuple[float, ...], ...]  # one for every frame, all of one length
    hold: bool = False  # hold the first and last value before and after; otherwise those frames are undefined
    name: str = "motion"  # of the moving object, for messages

    def __call__(self, t: float) -> np.ndarray:
        """The value at frame t. Raises InputError where it is undefined."""
        if not self.hold and not self.frames[0] <= t <= self.frames[-1]:
            first, last = self.frames[0], self.frames[-1]
            raise InputError(
                f"{self.name}: undefined at frame {t:g}: its keyframes cover {first:g} to {last:g}; one frame before "
                "the first and after the last rendered one is needed; add keyframes or hold = true"
            )
        return np.array([np.interp(t, self.frames, column) for column in zip(*self.values, strict=True)])


@dataclass(frozen=True)
class Motion:
    """Rigid motion of an object away from its rest pose. All parts add up; at `start` there is no rotation yet."""

    pivot: Vector = (0.0, 0.0, 0.0)  # rest position of the point that the object turns about
    start: float = 0.0  # frame of the rest pose
    velocity: Vector = (0.0, 0.0, 0.0)  # constant translation
    swing: Vector = (0.0, 0.0, 0.0)  # amplitude of a sinusoidal translation
    period: float = 24.0  # of the swing, in frames
    phase: float = 0.0  # of the swing, in degrees
    axis: Vector = (0.0, 1.0, 0.0)  # of the spin and of the orbit
    spin: float = 0.0  # rotation about the pivot
    orbit: Vector = (0.0, 0.0, 0.0)  # from the orbit's centre to the pivot at rest
    orbit_speed: float = 0.0
    keys: Keyframes | None = None  # (x, y, z, degrees about `axis`), added to the rest

    def __call__(self, t: float) -> np.ndarray:
        """[4, 4] from the rest pose, in world space, to the pose at frame t. Raises InputError where keys end."""
        *shift, degrees = self.keys(t) if self.keys else (0.0, 0.0, 0.0, 0.0)
        t = t - self.start
        pivot, orbit = np.array(self.pivot), np.array(self.orbit)
        offset = np.array(self.velocity) * t
        offset += np.array(self.swing) * np.sin(np.radians(360 * t / self.period + self.phase))
        offset += rotation(self.axis, self.orbit_speed * t) @ orbit - orbit
        offset += shift
        turn = rotation(self.axis, self.spin * t + degrees)
        return rigid(turn, pivot + offset - turn @ pivot)


@dataclass(frozen=True)
class Camera:
    """A camera at one moment. Projections are those of a pinhole in the middle of its lens."""

    to_world: np.ndarray  # [4, 4]; columns: right, down, forward, origin
    fov: float  # horizontal field of view, of the whole picture
    shot: int = 0  # frames of different shots have a cut between them, which no motion crosses
    window: tuple[int, int, int, int] | None = None  # of a larger picture: (its height, width, top, left)
    aperture: float = 0.0  # radius of the lens; 0: everything is sharp
    focus: float = 1.0  # distance of the sharp plane along the axis

    def _pinhole(self, size: tuple[int, int]) -> tuple[float, float, float]:
        """Distance of the image plane, and the column and row of the optical axis, in pixels of an image `size`."""
        height, width, top, left = self.window or (*size, 0, 0)
        return width / 2 / np.tan(np.radians(self.fov) / 2), width / 2 - left, height / 2 - top

    def world_to_pixel(self, size: tuple[int, int]) -> np.ndarray:
        """[4, 4]: world point (x, y, z, 1) → (column·w, row·w, 1, w), w = distance along the axis. size = (H, W)."""
        f, x, y = self._pinhole(size)
        intrinsic = np.array([[f, 0, x, 0], [0, f, y, 0], [0, 0, 0, 1], [0, 0, 1, 0]])
        return intrinsic @ np.linalg.inv(self.to_world)

    def world_from_pixel(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """(origin [3], matrix [3, 3]): direction = matrix · (column, row, 1)."""
        f, x, y = self._pinhole(size)
        inverse = np.array([[1 / f, 0, -x / f], [0, 1 / f, -y / f], [0, 0, 1]])
        return self.to_world[:3, 3], self.to_world[:3, :3] @ inverse


def look_at(origin, target, fov: float, roll: float = 0.0) -> Camera:
    """The camera at `origin` with `target` in the middle of the image and +y up; where it looks straight up or down, -z
    is. Raises InputError where both are in one place."""
    forward = np.asarray(target, float) - origin
    if not np.linalg.norm(forward) > 0:
        raise InputError(f"the camera at {origin} looks at its own place")
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 1, 0))
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(forward, (0, 0, -1))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], 1)
    return Camera(rigid(rotation(forward, roll) @ axes, origin), fov)


@dataclass(frozen=True)
class CameraPath:
    """A camera that dollies, orbits, pans and shakes; all parts add up."""

    origin: Vector
    target: Vector
    fov: float = 60.0
    start: float = 0.0
    velocity: Vector = (0.0, 0.0, 0.0)  # dolly: moves origin and target alike
    orbit: float = 0.0  # of the origin about the vertical through the target
    pan: float = 0.0  # of the target about the vertical through the origin
    shake: float = 0.0  # hand-held: amplitude, in degrees, of slow and fast sines of the view's direction
    seed: int = 0  # of the shake's phases
    keys: Keyframes | None = None  # (origin, target) in six numbers, instead of `origin` and `target`
    aperture: float = 0.0  # radius of the lens; 0: no depth of field
    focus: float = 1.0  # distance of the sharp plane

    def slowed(self, factor: float) -> CameraPath:
        """The same path at `factor` times the speed; keyframes keep theirs."""
        velocity = tuple(factor * v for v in self.velocity)
        return replace(
            self, velocity=velocity, orbit=factor * self.orbit, pan=factor * self.pan, shake=factor * self.shake
        )

    def __call__(self, t: float) -> Camera:
        """The camera at frame t. Raises InputError where keys end."""
        origin, target = self.keys(t).reshape(2, 3) if self.keys else (np.array(self.origin), np.array(self.target))
        t = t - self.start
        up = (0, 1, 0)
        origin, target = (
            target + rotation(up, self.orbit * t) @ (origin - target),
            origin + rotation(up, self.pan * t) @ (target - origin),
        )
        phases = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, (2, 3))
        waves = np.sin(2 * np.pi * t / np.array([[11.0], [4.7]]) + phases) * [[1.0], [0.35]]
        yaw, pitch, roll = self.shake * waves.sum(0)
        distance = np.linalg.norm(target - origin)
        target = target + distance * np.radians(1) * np.array([yaw, pitch, 0])
        moved = np.array(self.velocity) * t
        camera = look_at(origin + moved, target + moved, self.fov, roll / 2)
        return replace(camera, aperture=self.aperture, focus=self.focus)


@dataclass(frozen=True)
class Shots:
    """Several cameras, one after the other, with cuts between them."""

    paths: tuple[CameraPath, ...]
    cuts: tuple[float, ...]  # first frame of every path but the first, ascending

    def __call__(self, t: float) -> Camera:
        shot = bisect_right(self.cuts, t)
        return replace(self.paths[shot](t), shot=shot)
