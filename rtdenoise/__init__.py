"""Real-time denoising of path-traced animations: 1 sample per pixel in, a clean and temporally stable picture out.

Frames in memory, numpy or torch, one call each:

    denoiser = rtdenoise.Denoiser()
    clean = denoiser(color, albedo=albedo, normal=normal, depth=depth, motion=motion)    # [H, W, 3]

Files, with the state in your own hands:

    denoiser, history = rtdenoise.load("hybrid"), None
    for frame in rtdenoise.open_sequence("shot/", signal="indirect"):
        image, history = denoiser.step(frame, history)                                   # [1, 3, H, W]
"""

from importlib import import_module

from .errors import InputError

__version__ = "0.1.0"
__all__ = [
    "Denoiser", "Frame", "History", "InputError", "denoise_alpha", "load", "open_sequence", "pinhole_camera",
    "screen_motion",
]  # fmt: skip

# Imported on first use: `rtdenoise.glsl` runs without torch.
_HOMES = {
    "Denoiser": "run.session", "Frame": "frame", "History": "frame", "denoise_alpha": "data.alpha", "load": "models",
    "open_sequence": "data.opening", "pinhole_camera": "data.camera", "screen_motion": "data.camera",
}  # fmt: skip


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
