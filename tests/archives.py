"""Zip files of Zarr arrays as noisebase's data sets have them: a textured plane, a tile that slides on it, some sky."""

import numcodecs
import numpy as np
import zarr

STEP = np.array([0.05, -0.02, 0.0])  # of the tile in a picture 64 pixels wide, world units a frame


def camera(number, size):
    """The camera arrays of a picture of `size` = (H, W); the camera moves by some pixels a frame."""
    speed = 64 / size[1]
    eye = np.array([0.12, 0.07, 0.02]) * number * speed - [0, 0, 2]
    target, up = eye + np.array([0.02 * number * speed, 0, 1]), np.array([0.0, 1.0, 0.0])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(right, forward), forward]
    view[:3, 3] = -view[:3, :3] @ eye
    narrow = 1.75 * size[0] / size[1]
    projection = np.array([[narrow, 0, 0, 0], [0, 1.75, 0, 0], [0, 0, 1.0001, -0.10001], [0, 0, 1, 0]])
    made = {"camera_position": eye, "camera_target": target, "camera_up": up, "proj_mat": projection,
            "view_proj_mat": (projection @ view).T}  # fmt: skip
    return {name: array.astype(np.float32) for name, array in made.items()}


def frame(number, size, window=None, offset=(0, 0), samples=8):
    """The arrays of one frame by name; `window` = (H, W) of the crop at `offset`, the whole picture without."""
    window, rng, lens = window or size, np.random.default_rng(number), camera(number, size)
    eye = lens["camera_position"].astype(np.float64)
    to_pixel = np.array([[size[1] / 2, 0, 0, size[1] / 2], [0, -size[0] / 2, 0, size[0] / 2], [0, 0, 0, 1]])
    to_pixel = to_pixel @ lens["view_proj_mat"].T
    y, x = (i[..., None] + o + rng.random((*window, samples)) for i, o in zip(np.indices(window), offset, strict=True))
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(to_pixel[:, :3]).T
    position = eye - rays * (eye[2] / rays[..., 2:])
    step = STEP * 64 / size[1]
    tile = (np.abs(position[..., :2] - step[:2] * number) < 18 / size[0]).all(-1, keepdims=True)  # 16 pixels wide
    sky = position[..., :1] > 23 / size[0]
    detail = 9 * size[1] / 64 * position
    texture = 0.5 + 0.2 * (np.sin(detail[..., :1] + [0, 2, 4]) + np.cos(1.2 * detail[..., 1:2] + [1, 3, 5]))
    albedo = np.where(sky, 0, np.where(tile, 0.3, texture))
    clean = np.where(sky, 0.8, 2 * albedo)
    arrays = {
        "position": (np.where(sky, 0, position), np.float32),
        "motion": (np.where(tile & ~sky, -step, 0), np.float32),
        "normal": (np.where(sky, 0, [0.0, 0.0, -1.0]), np.float16),
        "diffuse": (albedo, np.float16),
    }
    made = {n: np.ascontiguousarray(array.transpose(3, 0, 1, 2), dtype) for n, (array, dtype) in arrays.items()}
    color = (clean * rng.exponential(size=sky.shape)).transpose(3, 0, 1, 2).astype(np.float32)
    rgbe, exposure = encode(color)
    return lens | made | {
        "color": rgbe,
        "exposure": exposure,
        "reference": clean.mean(2).transpose(2, 0, 1).astype(np.float32),
        "crop_offset": np.array(offset, np.int32),
    }  # fmt: skip


def encode(color):
    """Radiance `[3, H, W, S]`, nowhere all black, as RGBE and its exposure; rounded, where noisebase dithers."""
    low, high = np.log(color[color > 0].min()), np.log(color.max())
    e = np.clip((np.log(color.max(0, keepdims=True)) - low) / (high - low) * 256, 0, 255).astype(np.uint8)
    scale = np.exp((e.astype(np.float32) + 1) / 256 * (high - low) + low)
    return np.concatenate([np.rint(color / scale * 255).astype(np.uint8), e]), np.array([low, high], np.float32)


def write(path, frames):
    """A file of one frame, or of a sequence where `frames` is a list: LZ4HC, chunks of one frame and 4 samples."""
    sequence = isinstance(frames, list)
    arrays = {name: np.stack([f[name] for f in frames]) for name in frames[0]} if sequence else frames
    with zarr.storage.ZipStore(path, mode="w") as store:
        group = zarr.open_group(store, mode="w", zarr_format=2)  # as zarr 2 writes it, with which the data were made
        for name, array in arrays.items():
            chunks = (1, *array.shape[1:]) if sequence else array.shape
            if array.ndim == 4 + sequence:
                chunks = (*chunks[:-1], min(4, chunks[-1]))
            group.create_array(name, data=array, chunks=chunks, compressors=numcodecs.Blosc("lz4hc", clevel=9))
    return path
