"""Motion and depth from positions, object ids, and the cameras and transforms of `scene.json`. numpy only.

A camera is a matrix `[3, 4]` with rows x·w, y·w and w: the homogeneous point P is at pixel (x·w / w, y·w / w).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..frame import OFF_SCREEN, Frame

NEAREST = 1e-6  # the least w of points in front of a camera


def motion_between(
    position: np.ndarray,  # [3, H, W] world space, at the time of `here`
    ids: np.ndarray,  # [1, H, W] object ids, 0: nothing hit
    here: Mapping,  # scene.json's entry of the frame that `position` belongs to
    there: Mapping,  # the entry of the frame before or after it
) -> np.ndarray:  # [2, H, W] pixels, `there` minus `here`
    """Exact screen motion of rigidly moving objects under a moving camera.

        p' = W_there W_here⁻¹ p,    motion = project_there(p') - project_here(p)

    with W an object's object-to-world matrix (absent: it does not move) and project the frame's world-to-pixel matrix.
    Where nothing was hit the point is at infinity along the pixel's ray: only the rotation of the camera counts.
    `OFF_SCREEN` stands for points behind the other frame's camera, and everywhere where the two frames belong to
    different shots (entry "shot", 0 if absent): no history survives a cut. Computed in float64, returned in the dtype
    of `position`.
    """
    size = position.shape[1:]
    if here.get("shot", 0) != there.get("shot", 0):
        return np.full((2, *size), OFF_SCREEN, position.dtype)
    # Of the four rows of world-to-pixel the one for depth plays no part.
    to_here, to_there = (np.asarray(entry["world_to_pixel"], np.float64)[[0, 1, 3]] for entry in (here, there))
    point = homogeneous(position, ids != 0, to_here)
    moved = point
    for key in here["object_to_world"].keys() & there["object_to_world"].keys():
        before, after = (np.asarray(entry["object_to_world"][key], np.float64) for entry in (here, there))
        moved = np.where(ids == int(key), np.tensordot(after @ np.linalg.inv(before), point, 1), moved)
    return pixel_motion(to_here, to_there, point, moved).astype(position.dtype)


def homogeneous(
    position: np.ndarray,  # [3, H, W] world space
    hit: np.ndarray,  # [1, H, W] bool
    camera: np.ndarray,  # [3, 4]
) -> np.ndarray:  # [4, H, W] float64
    """Surfaces (w = 1) where something was hit, else the point at infinity along the pixel's ray (w = 0)."""
    rows, columns = np.mgrid[: position.shape[1], : position.shape[2]] + 0.5
    ray = np.tensordot(np.linalg.inv(camera[:, :3]), np.stack([columns, rows, np.ones_like(rows)]), 1)
    return np.concatenate([np.where(hit, position, ray), hit])


def pixel_motion(
    here: np.ndarray,  # [3, 4] camera
    there: np.ndarray,  # [3, 4] camera
    point: np.ndarray,  # [4, H, W] as `here` sees it
    moved: np.ndarray,  # [4, H, W] the same point at the time of `there`
) -> np.ndarray:  # [2, H, W] pixels
    """Where `there` sees the moved point minus where `here` sees the point; `OFF_SCREEN` where it is behind `there`."""
    now, then = np.tensordot(here, point, 1), np.tensordot(there, moved, 1)
    with np.errstate(all="ignore"):
        return np.where(then[2:] > NEAREST, then[:2] / then[2:] - now[:2] / now[2:], OFF_SCREEN)


def complete(frame: Frame, scene: Mapping) -> Frame:
    """The frame (numpy arrays, B = 1) with the depth, motion and motion_next that it lacks and `scene` gives.

    `scene` is the checked content of scene.json (`scene_file.read_scene`). Motion needs the entry of the frame before,
    motion_next that of the frame after. Where a scene has no objects and a frame no ids, all that was hit (position
    ≠ 0) is one object that does not move.
    """
    entries = {entry["number"]: entry for entry in scene["frames"]}
    here = entries.get(frame.number)
    if frame.position is None or here is None:
        return frame
    if frame.id is None and not scene["objects"]:
        frame = replace(frame, id=(frame.position != 0).any(1, keepdims=True).astype(np.float32))
    if frame.id is None:
        return frame
    if frame.depth is None:
        origin = np.asarray(here["camera_origin"], np.float32).reshape(1, 3, 1, 1)
        distance = np.linalg.norm(frame.position - origin, axis=1, keepdims=True)
        frame = replace(frame, depth=np.where(frame.id != 0, distance, np.float32(0)))
    others = {"motion": frame.number - 1, "motion_next": frame.number + 1}
    missing = [layer for layer in others if getattr(frame, layer) is None and others[layer] in entries]
    return replace(frame, **{
        layer: motion_between(frame.position[0], frame.id[0], here, entries[others[layer]])[None] for layer in missing
    })  # fmt: skip
