"""`denoise --offline` for light in parts (`light`): the picture comes first, by all frames, in a hidden folder inside
the output folder. It takes the place of the one that is denoised as a whole. Then the light is denoised, two frames
ahead: over both directions in time it would take as much disk for each pass as the picture does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from ..data.output import read_result
from ..data.output_files import output_names
from ..data.sequences import Sequence
from ..files import LOCK
from .folder import clear, refuse_no_folder
from .options import FEW_AHEAD, Options
from .state import STATE
from .summary import SUMMARY, Summary

FOLDER = ".rtdenoise-picture"


class Picture:
    """The picture of each frame, once it is made."""

    def __init__(
        self, source: str, out: Path, options: Options, overwrite: bool, on_frame: Callable[[int, int], None]
    ) -> None:
        """As `denoise.denoise`. `on_frame` counts the frames three times, twice of them for the picture."""
        self._source, self._folder, self._overwrite, self._on_frame = source, out / FOLDER, overwrite, on_frame
        self._options = replace(options, lights=False, also=(), layout="plain", float32=True)
        self.options_of_light = replace(options, lookahead=FEW_AHEAD)

    def on_frame_of_light(self, done: int, total: int) -> None:
        """Progress of the light."""
        self._on_frame(2 * total + done, 3 * total)

    def make(self, sequence: Sequence) -> Summary:
        """Denoise the picture, or go on where that was interrupted."""
        from .offline import denoise_offline

        refuse_no_folder(self._folder)
        self._sequence = sequence
        return denoise_offline(
            self._source, self._folder, self._options, self._overwrite,
            lambda done, total: self._on_frame(done, 3 * total // 2),
        )  # fmt: skip

    def read(self, number: int) -> np.ndarray:
        """The picture of a frame, `[1, 3, H, W]` of `Sequence.read_size`."""
        stored = read_result(self._folder, self._sequence, self._sequence.numbers.index(number))
        return np.stack([self._sequence.around(plane) for plane in stored[0]])[None]

    def remove(self, sequence: Sequence) -> None:
        """Remove the pictures, and the folder unless it holds anything else."""
        clear(self._folder, {*chain(*output_names(sequence, "plain", False)), SUMMARY, STATE, LOCK}.__contains__)
