"""Screen motion from world positions and cameras, for renderers that write no motion vectors. numpy only.

A camera is a matrix `[3, 4]` with rows x·w, y·w and w: the homogeneous point P is at pixel (x·w / w, y·w / w), and in
front of the camera where w > 0. An orthographic camera has the same w everywhere. A matrix `[4, 4]` has a row for depth
in between, which plays no part here.
"""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real

import numpy as np

from ..errors import InputError
from ..frame import OFF_SCREEN

MIN_W = 1e-7  # of points in front of a camera, relative to the terms of w: positions are float32
AXES = {"mitsuba": (-1, -1, 1), "opengl": (1, -1, -1), "opencv": (1, 1, 1)}
"""Convention of a camera's own axes -> the signs that turn them into x right, y down, z forward."""


def pinhole_camera(
    to_world: np.ndarray,  # [4, 4] camera-to-world
    fov: float,  # degrees across the width of the picture
    size: tuple[int, int],  # (H, W) of the picture
    convention: str = "mitsuba",  # of the camera's axes: "mitsuba", "opengl" (Blender too) or "opencv"
) -> np.ndarray:  # [3, 4]
    """The matrix `[3, 4]` of a perspective camera with square pixels and a centred axis, for `screen_motion`.

    `to_world` is camera-to-world `[4, 4]`, `fov` the angle across the picture's width in degrees, `size` is (H, W).
    Axes, in camera space: 'mitsuba' x left, y up, z forward; 'opengl' x right, y up, z backward; 'opencv' x right, y
    down, z forward. Raises InputError for another convention, an angle outside (0, 180), a size below 1, and a matrix
    that is not a camera-to-world.
    """
    if convention not in AXES:
        raise InputError(f"unknown camera convention {convention!r}; expected one of {', '.join(AXES)}")
    height, width = _numbers("size", size, (2,))
    angle = _numbers("fov", fov, ())
    if not min(height, width) >= 1:
        raise InputError(f"size: expected (H, W) of 1 or more, got {size}")
    if not 0 < angle < 180:
        raise InputError(f"fov: expected degrees between 0 and 180, got {fov}")
    focal = width / 2 / np.tan(np.radians(angle) / 2)
    intrinsic = np.array([[focal, 0, width / 2, 0], [0, focal, height / 2, 0], [0, 0, 1, 0]])
    to_camera = np.linalg.inv(_pose("to_world", to_world))
    return intrinsic @ np.diag([*AXES[convention], 1]) @ to_camera


def screen_motion(
    position: np.ndarray,  # [H, W, 3] world space, of the surface in each pixel of this frame
    camera: np.ndarray,  # [3, 4] or [4, 4] of this frame
    other: np.ndarray,  # [3, 4] or [4, 4] of the frame before (for `motion`) or after (for `motion_next`)
    *,
    hit: np.ndarray | None = None,  # [H, W] bool: where a surface was hit; None: where `position` is not 0
    ids: np.ndarray | None = None,  # [H, W] number of the object in each pixel
    poses: Mapping[int, np.ndarray] | None = None,  # number -> object-to-world [4, 4] in this frame, of moving objects
    other_poses: Mapping[int, np.ndarray] | None = None,  # the same in the other frame
) -> np.ndarray:  # [H, W, 2] float32, (x, y) in pixels, the other frame minus this one; x right, y down
    """Exact screen motion of rigidly moving objects under a moving camera: `[H, W, 2]` float32, (x, y) in pixels, the
    other frame minus this one. With the frame before as the other it is `motion`, with the frame after `motion_next`.

        p' = pose_other pose⁻¹ p,    motion = project_other(p') - project(p)

    `position` is `[H, W, 3]` in world space; `camera` and `other` are matrices as `pinhole_camera` makes them; `hit`
    `[H, W]` says where a surface was hit (None: where `position` is not 0). `ids` `[H, W]` number the objects; `poses`
    and `other_poses` map the numbers of those that move to object-to-world matrices `[4, 4]`.

    Objects without a pose stand still. Where nothing was hit the point is at infinity along the pixel's ray: only the
    camera's rotation counts. An orthographic camera sees one such point, which stands still. `OFF_SCREEN` stands for
    points behind the other camera, where its w is not positive. Raises InputError for arrays of other shapes, singular
    matrices, poses of what is no number, and objects with a pose in one of the frames alone.
    """
    position = _numbers("position", position)
    if position.ndim != 3 or position.shape[2] != 3:
        raise InputError(f"position: expected [H, W, 3], got {position.shape}")
    size = position.shape[:2]
    here, there = (_camera(name, m) for name, m in (("camera", camera), ("other", other)))
    hit = (position != 0).any(2) if hit is None else _plane("hit", hit, size).astype(bool)
    poses, other_poses = _numbered("poses", poses), _numbered("other_poses", other_poses)
    if lone := sorted(poses.keys() ^ other_poses.keys()):
        raise InputError(f"object {lone[0]} has a pose in one of the frames only; give both, or none where it is still")
    if poses and ids is None:
        raise InputError("poses need ids [H, W]: which object each pixel shows")
    numbers = np.zeros(size) if ids is None else _plane("ids", ids, size)
    pairs = {key: tuple(_pose(f"pose of object {key}", p[key]) for p in (poses, other_poses)) for key in poses}
    motion = rigid_motion(np.moveaxis(position, 2, 0), hit[None], numbers[None], here, there, pairs)
    return np.ascontiguousarray(np.moveaxis(motion, 0, 2), np.float32)


def rigid_motion(
    position: np.ndarray,  # [3, H, W] world space
    hit: np.ndarray,  # [1, H, W] bool
    ids: np.ndarray,  # [1, H, W] object numbers
    here: np.ndarray,  # [3, 4] camera of the frame that `position` belongs to
    there: np.ndarray,  # [3, 4] camera of the other frame
    poses: Mapping[int, tuple[np.ndarray, np.ndarray]],  # number -> object-to-world [4, 4], here and there
) -> np.ndarray:  # [2, H, W] float64 pixels
    """`screen_motion` on planes, in float64."""
    point = homogeneous(position, hit, here)
    moved = point
    for key, (before, after) in poses.items():
        step = np.asarray(after, np.float64) @ np.linalg.inv(np.asarray(before, np.float64))
        moved = np.where(hit & (ids == key), np.tensordot(step, point, 1), moved)
    return pixel_motion(here, there, point, moved)


def homogeneous(
    position: np.ndarray,  # [3, H, W] world space
    hit: np.ndarray,  # [1, H, W] bool
    camera: np.ndarray,  # [3, 4]
) -> np.ndarray:  # [4, H, W] float64
    """Surfaces (w = 1) where something was hit, else the point at infinity along the pixel's ray (w = 0); all four are
    0 under an orthographic camera, which has a single one."""
    ray = np.zeros(position.shape)
    if _is_perspective(camera) and not hit.all():
        rows, columns = np.mgrid[: position.shape[1], : position.shape[2]] + 0.5
        ray = np.tensordot(np.linalg.inv(camera[:, :3]), np.stack([columns, rows, np.ones_like(rows)]), 1)
    return np.concatenate([np.where(hit, position, ray), hit])


def pixel_motion(
    here: np.ndarray,  # [3, 4] camera
    there: np.ndarray,  # [3, 4] camera
    point: np.ndarray,  # [4, H, W] as `here` sees it
    moved: np.ndarray,  # [4, H, W] the same point at the time of `there`
) -> np.ndarray:  # [2, H, W] pixels
    """Where `there` sees the moved point minus where `here` sees the point; `OFF_SCREEN` where it is behind `there`, 0
    for points that are all 0."""
    with np.errstate(all="ignore"):
        now, then = np.tensordot(here, point, 1), np.tensordot(there, moved, 1)
        front = then[2:] > MIN_W * np.tensordot(abs(there[2:]), abs(moved), 1)
        motion = np.where(front, then[:2] / then[2:] - now[:2] / now[2:], OFF_SCREEN)
    return np.where(point.any(0), motion, 0)


def projection(matrix: np.ndarray) -> np.ndarray:
    """The camera `[3, 4]` in a matrix that may have a row for depth."""
    matrix = np.asarray(matrix, np.float64)
    return matrix[[0, 1, 3]] if len(matrix) == 4 else matrix


def _is_perspective(camera: np.ndarray) -> bool:
    """Whether w depends on the point, beyond rounding."""
    return np.linalg.norm(camera[2, :3]) > 1e-12 * np.linalg.norm(camera[2])


def _numbered(name: str, poses: Mapping[int, np.ndarray] | None) -> Mapping[int, np.ndarray]:
    """Poses by the numbers of their objects. Raises InputError for other keys, such as the text of JSON: no pixel shows
    such an object."""
    poses = poses or {}
    if not isinstance(poses, Mapping):
        raise InputError(f"{name}: expected object numbers with a matrix each, got {type(poses).__name__}")
    if wrong := [key for key in poses if not isinstance(key, Real)]:
        raise InputError(f"{name}: expected numbers of objects as in ids, got {wrong[0]!r}")
    return poses


def _camera(name: str, matrix: np.ndarray) -> np.ndarray:
    matrix = _numbers(name, matrix)
    if matrix.shape not in ((3, 4), (4, 4)):
        raise InputError(f"{name}: expected a matrix [3, 4] or [4, 4], got {matrix.shape}")
    matrix = projection(matrix)
    _expect_regular(name, matrix, matrix[:, :3] if _is_perspective(matrix) else matrix[:2, :3])
    return matrix


def _pose(name: str, matrix: np.ndarray) -> np.ndarray:
    """A matrix `[4, 4]` from an object or a camera to the world."""
    matrix = _numbers(name, matrix)
    if matrix.shape != (4, 4):
        raise InputError(f"{name}: expected a matrix [4, 4], got {matrix.shape}")
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-6):
        raise InputError(f"{name}: expected a last row of 0, 0, 0, 1; is it transposed?")
    _expect_regular(name, matrix, matrix[:3, :3])
    return matrix


def _expect_regular(name: str, matrix: np.ndarray, part: np.ndarray) -> None:
    """Raise InputError unless the matrix is finite without rows of zeros, and the rows of its part are independent."""
    lengths = np.linalg.norm(part, axis=1, keepdims=True)
    whole = np.isfinite(matrix).all() and matrix.any(1).all() and lengths.all()
    if not (whole and np.linalg.matrix_rank(part / lengths) == len(part)):
        raise InputError(f"{name}: the matrix is singular or not finite")


def _numbers(name: str, array: np.ndarray, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """The array in float64. Raises InputError for what is none, text too, or has another shape."""
    try:
        numbers = None if np.asarray(array).dtype.kind in "US" else np.asarray(array, np.float64)
    except (TypeError, ValueError):
        numbers = None
    if numbers is None:
        raise InputError(f"{name}: expected numbers, got {type(array).__name__}")
    if shape not in (None, numbers.shape):
        expected = f"{shape[0]} numbers" if shape else "one number"
        raise InputError(f"{name}: expected {expected}, got an array {numbers.shape}")
    return numbers


def _plane(name: str, plane: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    plane = _numbers(name, plane)
    plane = plane[..., 0] if plane.ndim == 3 and plane.shape[2] == 1 else plane
    if plane.shape != size:
        raise InputError(f"{name}: expected {size} as position, got {plane.shape}")
    return plane
