"""A denoised frame as a file: in `R,G,B`, or in the channels where the renderer's file has the signal; alone, or
recombined with the rest of the light.

With S the noisy signal, D the denoised one, C the noisy beauty and A the albedo if the renderer has divided the signal
by it (else 1), the recombined beauty is

    signal color      D · A
    signal indirect   C + (D − S) · A

The second replaces the noisy indirect light in the sum of all lights: Cycles' Combined is Σ (direct + indirect) · color
over diffuse, glossy and transmission, plus emission and environment: all terms but S · A cancel out. So the formula
needs none of those passes, and holds for scenes with further ones (volumes).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..constants import MAX_HALF
from ..errors import InputError
from ..frame import Frame
from ..sanitise import valid
from .alpha import denoise_alpha
from .exr import read_attributes, read_channels, write_layers, write_like
from .layout import Rule
from .output_files import kept_channels, name_of, place_of
from .sequences import Sequence, convert
from .shutter import over_shutter

NOTHING: Mapping[str, np.ndarray] = MappingProxyType({})
PLAIN = Rule(("R", "G", "B"), (1, 1, 1))


def recombined(sequence: Sequence, index: int, frame: Frame, image: np.ndarray) -> np.ndarray:
    """The beauty `[1, 3, H, W]` with the denoised signal `image` in it; the equation stands above. Never negative;
    where the input is not finite, the rest counts as 0."""
    albedo = valid("albedo", frame.albedo) if sequence.demodulated else np.ones_like(image)
    if sequence.signal == "color":
        return image * albedo
    rule = sequence.layout.resolve(sequence.header, "color")["radiance"]
    color = convert(rule, sequence.planes(index, rule.channels), "radiance")
    with np.errstate(invalid="ignore"):
        rest = np.nan_to_num(color - frame.radiance * albedo, nan=0.0, posinf=0.0, neginf=0.0)
    return (rest + image * albedo).clip(min=0)


def read_result(
    out: Path, sequence: Sequence, index: int, layout: str = "plain", recombine: bool = False
) -> np.ndarray:  # [1, 3, H, W]
    """The denoised signal, or the beauty, that `write_frame` wrote with these options."""
    path = sequence.paths[index]
    if layout == "plain":
        plain = read_channels(out / sequence.names[index], PLAIN.channels)
        return convert(PLAIN, plain, "radiance")
    beauty = sequence.layout.beauty_rule(sequence.header) if recombine else None
    rule = beauty or place_of(sequence)
    ((file, names),) = sequence.files[index].locate(rule.channels).items()
    stored = read_channels(out / name_of(file, path), tuple(names.values()))
    return convert(rule, {full: stored[name] for full, name in names.items()}, "radiance")


def write_frame(
    out: Path,  # folder
    sequence: Sequence,
    index: int,
    frame: Frame,  # as `Sequence.read` gives it
    image: np.ndarray,  # [1, 3, H, W] the denoised signal
    *,
    layout: str = "plain",
    recombine: bool = False,
    keep: tuple[str, ...] = (),  # layers or channels of the input to pass on, or "all"; plain layout only
    float32: bool = False,  # as always where half floats do not hold the result
    alpha: str = "auto",  # of the beauty: as rendered, or with 'auto' denoised where samples are few
    shutter: tuple[float, float] | None = None,  # frames from the time of this one: what moves is blurred
    coverage: np.ndarray | None = None,  # [H, W] the beauty's alpha, where it has been denoised as light
    extra: Mapping[str, np.ndarray] = NOTHING,  # layer -> [1, C, H, W], written too; plain layout only
) -> dict[str, int]:
    """Write one frame under the name of the input file that holds the signal. Returns the number of NaNs in each
    channel that is passed on unchanged and has some.

    plain    the signal in `R,G,B`, with `recombine` the beauty instead; the beauty's alpha in `A`; the channels of
             `keep`; of the attributes those that say something of the picture
    source   every channel of the input under its name and in its part; the denoised signal replaces the noisy one,
             with `recombine` also the new beauty the renderer's, and where that is new, so is its alpha. Where buffers
             are files of their own, only changed files are written.

    Raises InputError where the result is not finite, and where the file cannot be written.
    """
    beauty = recombined(sequence, index, frame, image) if recombine else None
    path = sequence.paths[index]
    for result in (image, beauty):
        if result is not None and (bad := int((~np.isfinite(result)).any(1).sum())):
            raise InputError(f"{path}: the result has {bad} pixels that are not finite, so it was not written; are the "
                             "weights of --model sound, and the frame's values plausible?")  # fmt: skip
    float32 = float32 or any(beyond_half(result) for result in (image, beauty) if result is not None)
    picture = image if sequence.signal == "color" and beauty is None else beauty
    covered = {} if picture is None else alpha_of(sequence, index, picture, alpha, coverage)
    if shutter:
        surface = frame.depth, frame.motion, frame.motion_next
        image = over_shutter(image, *surface, *shutter)
        covered = {name: over_shutter(plane[None, None], *surface, *shutter)[0, 0] for name, plane in covered.items()}
    extra, covered = ({name: sequence.within(plane) for name, plane in its.items()} for its in (extra, covered))
    image, beauty = (result if result is None else sequence.within(result) for result in (image, beauty))
    if layout == "plain":
        result = image if beauty is None else beauty
        return _write_plain(out / sequence.names[index], sequence, index, result, covered, keep, float32, extra)
    planes = _planes(place_of(sequence), image)
    if beauty is not None and (rule := sequence.layout.beauty_rule(sequence.header)):
        planes |= _planes(rule, beauty)
    if alpha != "rendered" or shutter:
        planes |= covered
    nans = {}
    for file, names in sequence.files[index].locate(planes).items():
        changed = {stored: planes[full] for full, stored in names.items()}
        nans |= write_like(out / name_of(file, path), file, changed, dtype="float" if float32 else None)
    return nans


def alpha_of(
    sequence: Sequence,
    index: int,
    picture: np.ndarray,  # [1, 3, H, W] the denoised beauty
    alpha: str,  # of `ALPHAS`
    coverage: np.ndarray | None = None,  # [H, W] instead of what would be found
) -> dict[str, np.ndarray]:
    """The channel of a frame's alpha and its values `[H, W]` beside the denoised picture, of the same size; empty where
    it has none."""
    stored = sequence.layout.alpha(sequence.header)
    if not stored or stored not in sequence.files[index].header().channels:
        return {}
    if coverage is None:
        plane = sequence.around(sequence.files[index].read([stored], as_stored=True)[stored])
        coverage = plane if alpha == "rendered" else denoise_alpha(plane, np.moveaxis(picture[0], 0, 2))
    return {stored: coverage}


def attributes_of(sequence: Sequence, index: int, kept: Collection[str] = ()) -> dict[str, object]:
    """The header attributes of a file that is made from a frame's and holds the channels `kept` of it, for
    `write_layers`."""
    path = sequence.paths[index]
    return (read_attributes(path, kept) if path.suffix.lower() == ".exr" else {}) | sequence.header.placing


def beyond_half(result: np.ndarray) -> bool:
    """Whether half floats do not hold values as large as a result's."""
    return bool(result.max() > MAX_HALF)


def _planes(rule: Rule, image: np.ndarray) -> dict[str, np.ndarray]:
    """The inverse of `convert` for radiance."""
    return {name: sign * plane for name, sign, plane in zip(rule.channels, rule.signs, image[0], strict=True)}


def _write_plain(
    path: Path,
    sequence: Sequence,
    index: int,
    image: np.ndarray,
    alpha: dict[str, np.ndarray],  # as `alpha_of` returns it
    keep: tuple[str, ...],
    float32: bool,
    extra: Mapping[str, np.ndarray],
) -> dict[str, int]:
    layers = {name: np.moveaxis(array[0], 0, 2) for name, array in {"color": image, **extra}.items()}
    dtypes = {"color": "float" if float32 else "half"}
    file = sequence.files[index]
    for channel, plane in alpha.items():
        layers["A"], dtypes["A"] = plane, file.header().channels[channel]
    made = {*layers, *(name for name in kept_channels(sequence, keep) if name.rpartition(".")[0] in extra)}
    passed = [name for name in kept_channels(sequence, keep) if name not in made]  # the picture's alpha is made, too
    layers |= file.read(passed, as_stored=True)
    dtypes |= {name: sequence.header.channels[name] for name in passed}
    write_layers(path, layers, dtypes=dtypes, attributes=attributes_of(sequence, index, passed))
    return {
        name: bad
        for name, plane in layers.items()
        if name not in ("color", *extra) and (bad := int((plane != plane).sum()))
    }
