"""Noisebase's data sets (SampleSet v1, and others in its format): Zarr arrays in zip files.

Its documentation names two formats: "Sample Test Format v1", one file for each frame (`frame0012.zip`), and "Sample
Training Format v1", one file for each sequence: its arrays have one more axis in front, the frames of a crop that moves
along with the picture. C components, H×W pixels and S samples a pixel make arrays `[C, H, W, S]`:

    color             uint8 RGBE, decoded with exposure `[2]` = (a, b):   rgb / 255 · exp(a + (b − a) (e + 1) / 256)
    reference         float32 `[3, H, W]`
    position, motion  float32, world space: the point at `position` was at `position + motion` in the frame before
    normal, diffuse   float16, world space; colour of the material

With M = view_proj_mat and (x, y, z, w) = (X, Y, Z, 1) M, a point is at column (1 + x/w) W'/2 and row (1 − y/w) H'/2
of the camera's picture, less `crop_offset` = (row, column).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import open_regular
from ..frame import OFF_SCREEN
from .camera import homogeneous, pixel_motion
from .exr_format import ExrHeader
from .files import FrameFiles, check_gaps, find_files, number_files
from .layout import Layout, rules

CAMERA = (1080, 1920)  # height and width of SampleSet v1's camera, which files of crops do not record
COMPONENTS = {
    "color": "RGB", "diffuse": "RGB", "normal": "XYZ", "position": "XYZ", "depth": "Z", "motion": "XY",
    "reference": "RGB",
}  # fmt: skip
ARRAYS = {  # name -> number of axes in a file of one frame
    "color": 4, "exposure": 1, "reference": 3, "position": 4, "motion": 4, "normal": 4, "diffuse": 4,
    "view_proj_mat": 2, "camera_position": 1, "crop_offset": 1,
}  # fmt: skip

NOISEBASE = Layout(
    "noisebase",
    {
        "color": rules("color", "RGB"),
        "albedo": rules("diffuse", "RGB"),
        **{layer: rules(layer, COMPONENTS[layer]) for layer in ("normal", "depth", "motion", "position", "reference")},
    },
    hints={
        "indirect": "noisebase has no array for it: denoise --signal color",
        "motion_next": "noisebase has motion to the frame before only",
    },
)


@dataclass(frozen=True)
class ArchiveFrame(FrameFiles):
    """A frame in a zip file of Zarr arrays, as if it were an EXR file with the channels `color.R`, `motion.X`, …

    Radiance, diffuse colour and normal are means over the first `samples`; position, depth and motion are those of the
    first sample, because a mean of two surfaces lies on neither. Motion of the first frame is `OFF_SCREEN`.
    """

    entry: int | None = None  # index in the file of a sequence; None: the file is one frame
    samples: int = 1
    before: ArchiveFrame | None = None  # the frame before, for its camera

    def output_name(self, file: Path) -> str:
        return f"{file.stem}.exr" if self.entry is None else f"{file.stem}.{self.number:04d}.exr"

    def header(self) -> ExrHeader:
        with _opened(self.path) as group:
            _, height, width, samples = group["color"].shape[-4:]
            for name in ("position", "motion", "normal", "diffuse", "reference"):
                shape = (3, height, width) if name == "reference" else (3, height, width, samples)
                if group[name].shape[-len(shape) :] != shape:
                    raise InputError(f"{self.path}: array '{name}' is {group[name].shape}, expected {shape} at its end")
        if self.samples > samples:
            raise InputError(f"{self.path}: has {samples} samples a pixel, {self.samples} were asked for (--preset "
                             f"noisebase:{samples} or fewer)")  # fmt: skip
        types = {name: "half" if name in ("normal", "diffuse") else "float" for name in COMPONENTS}
        channels = {f"{name}.{c}": types[name] for name, letters in COMPONENTS.items() for c in letters}
        return ExrHeader(self.path, width, height, channels, (), 0, self.samples)

    def read(self, names: Collection[str], as_stored: bool = False) -> dict[str, np.ndarray]:
        wanted = {name.partition(".")[0] for name in names}
        planes: dict[str, np.ndarray] = {}
        with _opened(self.path) as group:
            arrays = {name: self._layer(group, name) for name in wanted}
        for name, array in arrays.items():
            planes |= {f"{name}.{c}": plane for c, plane in zip(COMPONENTS[name], array, strict=True)}
        return {name: planes[name] for name in names}

    def _layer(self, group, name: str) -> np.ndarray:
        """One layer `[C, H, W]`, float32."""
        if name == "color":
            layer = _decode(self._array(group, "color", self.samples), self._array(group, "exposure")).mean(-1)
        elif name in ("normal", "diffuse"):
            layer = self._array(group, name, self.samples).mean(-1, dtype=np.float32)
        elif name == "reference":
            layer = self._array(group, name)
        elif name == "motion":
            layer = self._motion(group)
        else:
            layer = self._array(group, "position", 1)[..., 0]
            if name == "depth":
                origin = self._array(group, "camera_position").reshape(3, 1, 1)
                distance = np.linalg.norm(layer - origin, axis=0, keepdims=True)
                layer = np.where(self._hit(group, layer), distance, 0)
        return np.ascontiguousarray(layer, np.float32)

    def _motion(self, group) -> np.ndarray:
        """Previous − current in pixels of the crop, `[2, H, W]`. Sky moves with the rotation of the camera only."""
        position, change = (self._array(group, name, 1)[..., 0].astype(np.float64) for name in ("position", "motion"))
        H, W = position.shape[1:]
        if self.before is None:
            return np.full((2, H, W), OFF_SCREEN)
        here = self._to_pixel(group, (H, W))
        with _opened(self.before.path) as previous:
            there = self.before._to_pixel(previous, (H, W))
        hit = self._hit(group, position)
        point = homogeneous(position, hit, here)
        moved = point + np.concatenate([np.where(hit, change, 0), np.zeros((1, H, W))])
        return pixel_motion(here, there, point, moved)

    def _hit(self, group, position: np.ndarray) -> np.ndarray:
        """Whether there is a surface, `[1, H, W]`: sky has no normal, or no finite position."""
        normal = self._array(group, "normal", 1)[..., 0]
        return (normal != 0).any(0, keepdims=True) & np.isfinite(position).all(0, keepdims=True)

    def _to_pixel(self, group, size: tuple[int, int]) -> np.ndarray:
        """World to pixel, `[3, 4]`: rows x·w, y·w and w, without the one for depth."""
        height, width = size if self.entry is None else CAMERA
        row, column = self._array(group, "crop_offset") if self.entry is not None else (0, 0)
        matrix = self._array(group, "view_proj_mat").astype(np.float64)
        x, y = width / 2, height / 2
        return np.array([[x, 0, 0, x - column], [0, -y, 0, y - row], [0, 0, 0, 1]]) @ matrix.T

    def _array(self, group, name: str, samples: int | None = None) -> np.ndarray:
        """This frame's part of an array, all of it or its first samples."""
        frame = () if self.entry is None else (self.entry,)
        return np.asarray(group[name][(*frame, ..., *(() if samples is None else (slice(samples),)))])


def find_archives(
    path_or_glob: str | os.PathLike,  # a folder or glob of frames, or the file of one sequence
    samples: int = 1,  # how many samples a pixel are read
    allow_gaps: bool = False,
) -> tuple[ArchiveFrame, ...]:
    """The frames in order of their numbers. Raises `InputError` as `files.find_frames` does, for files that are not zip
    files of Zarr arrays, and where an array is missing."""
    files = find_files(path_or_glob, ".zip")
    with _opened(files[0]) as group:
        length = group["color"].shape[0] if group["color"].ndim == ARRAYS["color"] + 1 else None
    if length is not None and len(files) > 1:
        raise InputError(f"{files[0]}: is a sequence of {length} frames, and so are the other {len(files) - 1} files; "
                         "give one of them")  # fmt: skip
    if length is not None:
        numbered = [(number, files[0], number) for number in range(length)]
    else:
        numbered = [(number, file, None) for number, file in number_files(files)]
    frames: list[ArchiveFrame] = []
    for number, file, entry in numbered:
        follows = frames and frames[-1].number == number - 1
        before = ArchiveFrame(number - 1, frames[-1].files, frames[-1].entry) if follows else None
        frames.append(ArchiveFrame(number, {"": file}, entry, samples, before))
    check_gaps(frames, allow_gaps)
    return tuple(frames)


def _decode(rgbe: np.ndarray, exposure: np.ndarray) -> np.ndarray:
    """RGBE `[4, H, W, S]` uint8 to radiance `[3, H, W, S]`."""
    low, high = exposure.astype(np.float32)
    exponent = low + (high - low) * (rgbe[3:].astype(np.float32) + 1) / 256
    return rgbe[:3].astype(np.float32) / 255 * np.exp(exponent)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator:
    """The Zarr group in a zip file, with all arrays of the format."""
    try:
        import zarr
    except ImportError:
        raise InputError(f"{path}: noisebase's files are read with zarr: pip install 'rtdenoise[noisebase]'") from None
    open_regular(path).close()
    try:
        store = zarr.storage.ZipStore(path, mode="r")
        group = zarr.open_group(store, mode="r")
        with contextlib.closing(store):  # only now: zarr 3.1 cannot close a file that it could not open
            missing = [name for name in ARRAYS if name not in group]
            if missing:
                raise InputError(f"{path}: no array '{missing[0]}'; it has {', '.join(sorted(group)) or 'none'}")
            extra = {group[name].ndim - axes for name, axes in ARRAYS.items()}
            if extra not in ({0}, {1}):
                raise InputError(f"{path}: arrays of one frame and of a sequence in one file, expected either")
            yield group
    except (InputError, MemoryError):
        raise
    except Exception as error:  # zarr and its codecs have no class of their own for damaged files
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{path}: not a readable zip file of Zarr arrays: {reason}") from None
