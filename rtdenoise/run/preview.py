"""Pictures of a run to look at: strips noisy | denoised | reference, as PNG and as a GIF or MP4."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from ..color import display, display_exposure
from ..data.output import read_result, recombined
from ..data.sequences import Sequence, convert
from ..files import replacing
from ..frame import Frame
from ..sanitise import valid

if TYPE_CHECKING:
    from torch import Tensor

FRAMES_PER_SECOND = 12
MOST_FRAMES = 120
WIDEST = 1920  # pixels of an animation, which bounds its memory too


def preview(sequence: Sequence, out: Path, layout: str = "plain", recombine: bool = False) -> list[Path]:
    """Show the first frames of `sequence` beside their denoised files in `out`: `preview.png` (the last of
    these frames) and `preview.mp4`, or `preview.gif` where there is no ffmpeg, `WIDEST` pixels wide at most. Returns
    the files.

    The exposure is that of the last frame shown, for all of them, so that the preview adds no flicker.
    With `recombine` every panel shows the beauty: a noisy signal, too, with the rest of the light.
    """
    scale, strips = None, []
    for i in reversed(range(min(len(sequence), MOST_FRAMES))):
        frame, image = sequence.read(i), read_result(out, sequence, i, layout, recombine)
        frame = replace(frame, radiance=valid("radiance", frame.radiance))
        noisy = recombined(sequence, i, frame, frame.radiance) if recombine else frame.radiance
        reference = _reference(sequence, i, frame, recombine)
        panels = {"noisy": noisy, "denoised": image} | ({} if reference is None else {"reference": reference})
        if scale is None:
            scale = display_exposure(valid("radiance", panels.get("reference", image)))
        picture = strip(panels, scale)
        if not strips:
            with replacing(out / "preview.png", ".png") as temporary:
                picture.save(temporary)
        picture.thumbnail((WIDEST, WIDEST))
        strips.insert(0, picture)
    return [out / "preview.png", *([animate(strips, out / "preview")] if len(strips) > 1 else [])]


def _reference(sequence: Sequence, i: int, frame: Frame, recombine: bool) -> np.ndarray | None:
    """The converged picture of a frame `[1, 3, H, W]`, with `recombine` that of the beauty; None where the files lack
    it."""
    if recombine and sequence.signal != "color":
        rule = sequence.layout.resolve(sequence.header, "color").get("reference")
        return rule and convert(rule, sequence.files[i].read(rule.channels), "reference")
    if recombine and frame.reference is not None:
        return recombined(sequence, i, frame, frame.reference)
    return frame.reference


def animate(pictures: list[Image.Image], path: Path) -> Path:
    """Write pictures of one size as `path`.mp4 where ffmpeg is installed, else as `path`.gif; returns the file."""
    if shutil.which("ffmpeg"):
        width, height = (side // 2 * 2 for side in pictures[0].size)  # the codec wants even sides
        pixels = b"".join(picture.crop((0, 0, width, height)).tobytes() for picture in pictures)
        with contextlib.suppress(subprocess.CalledProcessError), replacing(path.with_suffix(".mp4"), ".mp4") as film:
            command = [
                "ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
                "-r", str(FRAMES_PER_SECOND), "-i", "-", "-pix_fmt", "yuv420p", str(film),
            ]  # fmt: skip
            subprocess.run(command, input=pixels, check=True)
            return path.with_suffix(".mp4")
    first, *rest = _in_256_colours(pictures)
    with replacing(path.with_suffix(".gif"), ".gif") as film:
        first.save(film, save_all=True, append_images=rest, duration=1000 // FRAMES_PER_SECOND, loop=0)
    return path.with_suffix(".gif")


def _in_256_colours(pictures: list[Image.Image]) -> list[Image.Image]:
    """The same colours for all: found in every fourth pixel of every fourth row, as all pixels take long."""
    few = np.concatenate([np.asarray(picture)[::4, ::4].reshape(1, -1, 3) for picture in pictures], axis=1)
    palette = Image.fromarray(few).quantize(256, Image.Quantize.MEDIANCUT)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]


def strip(panels: dict[str, Tensor | np.ndarray], scale: Tensor | float) -> Image.Image:
    """Images `[1, 3, H, W]` of linear radiance side by side, display-transformed at one exposure, each with its
    label."""
    gap = 4
    pictures = [to_picture(display(image, scale)) for image in panels.values()]
    width, height = pictures[0].size
    canvas = Image.new("RGB", ((width + gap) * len(pictures) - gap, height), "white")
    draw = ImageDraw.Draw(canvas)
    for i, (label, picture) in enumerate(zip(panels, pictures, strict=True)):
        canvas.paste(picture, ((width + gap) * i, 0))
        draw.text(((width + gap) * i + 6, height - 16), label, fill="white", stroke_width=1, stroke_fill="black")
    return canvas


def to_picture(image: Tensor | np.ndarray) -> Image.Image:
    """`[1, 3, H, W]` in [0, 1] to 8 bits; NaN is black."""
    values = np.moveaxis(np.asarray(image[0] if isinstance(image, np.ndarray) else image[0].cpu()), 0, 2)
    return Image.fromarray(np.round(np.nan_to_num(values) * 255).astype(np.uint8))
