"""Real-time denoising of path-traced animations: 1 sample per pixel in, a clean and temporally stable picture out.

    denoiser, history = rtdenoise.load("paper"), None
    for frame in rtdenoise.open_sequence("shot/", signal="indirect"):
        image, history = denoiser.step(frame, history)
"""

__version__ = "0.1.0"

from .data.sequences import open_sequence
from .errors import InputError
from .frame import Frame, History
from .models import load

__all__ = ["Frame", "History", "InputError", "load", "open_sequence"]
