"""Motion and depth from positions, object ids, and the cameras and transforms of `scene.json`. numpy only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..frame import OFF_SCREEN, Frame
from .camera import projection, rigid_motion


def motion_between(
    position: np.ndarray,  # [3, H, W] world space, at the time of `here`
    ids: np.ndarray,  # [1, H, W] object ids, 0: nothing hit
    here: Mapping,  # scene.json's entry of the frame that `position` belongs to
    there: Mapping,  # the entry of the frame before or after it
) -> np.ndarray:  # [2, H, W] pixels, `there` minus `here`
    """`camera.rigid_motion` between two entries of scene.json, in the dtype of `position`.

    `OFF_SCREEN` everywhere where the two frames belong to different shots (entry "shot", 0 if absent): no history
    survives a cut.
    """
    size = position.shape[1:]
    if here.get("shot", 0) != there.get("shot", 0):
        return np.full((2, *size), OFF_SCREEN, position.dtype)
    to_here, to_there = (projection(entry["world_to_pixel"]) for entry in (here, there))
    objects = here["object_to_world"], there["object_to_world"]
    poses = {int(key): (objects[0][key], objects[1][key]) for key in objects[0].keys() & objects[1].keys()}
    return rigid_motion(position, ids != 0, ids, to_here, to_there, poses).astype(position.dtype)


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
