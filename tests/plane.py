"""A textured plane seen by a moving perspective camera, exactly: the buffers that a renderer would write."""

import numpy as np

H, W, FRAMES = 48, 64, 4


def camera(number):
    """World-to-pixel `[3, 4]` (rows x·w, y·w, w) and the camera's place, in frame `number`; the plane is z = 0."""
    eye = np.array([0.12 * number, 0.07 * number, -2.0 + 0.02 * number])
    angle = 0.01 * number
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    lens = np.array([[W, 0, W / 2], [0, W, H / 2], [0, 0, 1]])
    rotation = lens @ turn
    return np.concatenate([rotation, (-rotation @ eye)[:, None]], 1), eye


def project(matrix, points):
    """Pixels `[..., 2]` of world points `[..., 3]`."""
    image = points @ matrix[:, :3].T + matrix[:, 3]
    return image[..., :2] / image[..., 2:]


def buffers(number):
    """name -> `[H, W, C]` float32: color, albedo, normal, position, depth (to the camera), linear_z, motion."""
    matrix, eye = camera(number)
    y, x = np.mgrid[:H, :W] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix[:, :3]).T
    position = eye - rays * (eye[2] / rays[..., 2:])
    texture = 0.5 + 0.2 * (np.sin(9 * position[..., :1] + [0, 2, 4]) + np.cos(11 * position[..., 1:2] + [1, 3, 5]))
    made = {
        "color": 2 * texture,
        "albedo": texture,
        "normal": np.broadcast_to([0.0, 0.0, -1.0], (H, W, 3)),
        "position": position,
        "depth": np.linalg.norm(position - eye, axis=-1, keepdims=True),
        "linear_z": (position @ matrix[2, :3] + matrix[2, 3])[..., None],
        "motion": project(camera(number - 1)[0], position) - np.stack([x, y], -1),
    }
    return {name: np.ascontiguousarray(image, np.float32) for name, image in made.items()}
