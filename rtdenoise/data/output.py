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

import os
from collections.abc import Iterator, Mapping
from itertools import chain
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
from .sequences import Sequence, convert
from .shutter import over_shutter

LAYOUTS = ("plain", "source")
ALPHAS = ("auto", "rendered")
NOTHING: Mapping[str, np.ndarray] = MappingProxyType({})
PLAIN = Rule(("R", "G", "B"), (1, 1, 1))


def check_output(
    sequence: Sequence, layout: str, recombine: bool, keep: tuple[str, ...], alpha: str = "auto"
) -> None:
    """Raise `InputError` for output that cannot be written, before anything is denoised."""
    for what, given, known in (("layout", layout, LAYOUTS), ("alpha", alpha, ALPHAS)):
        if given not in known:
            raise InputError(f"unknown {what} '{given}': known are {', '.join(known)}")
    if layout == "source" and sequence.paths[0].suffix.lower() != ".exr":
        raise InputError(f"{sequence.paths[0]}: layout 'source' copies EXR files, this is none: choose 'plain'")
    if layout == "source" and keep:
        raise InputError("layout 'source' passes every channel on: leave --keep out")
    sequence.require_channels(_kept(sequence, keep), "--keep")
    if recombine and sequence.signal != "color":
        beauty = sequence.layout.resolve(sequence.header, "color").get("radiance")
        if beauty is None:
            raise InputError(f"{sequence.paths[0]}: --recombine needs the beauty, the file has "
                             f"{sequence.header.summary}; {sequence.layout.hint('radiance', 'color')}")  # fmt: skip
        sequence.require_channels(beauty.channels, "--recombine")
    if recombine and sequence.demodulated and "albedo" not in sequence.rules:
        raise InputError(f"{sequence.paths[0]}: --recombine needs the albedo that the signal was divided by; "
                         f"{sequence.layout.hint('albedo', sequence.signal)}")  # fmt: skip
    sources: dict[str, Path] = {}
    for name, file in _written(sequence, layout, recombine):
        if name in sources:
            raise InputError(f"{file}: would be written to the same file as {sources[name]}: {name}; rename the files, "
                             "so that each has a name of its own")  # fmt: skip
        sources[name] = file


def protect_input(sequence: Sequence, out: Path, layout: str, recombine: bool) -> None:
    """Raise `InputError` where the output folder holds the input, or one of the output files is an input file: links
    are followed."""
    inputs = [path for frame in sequence.files for path in frame.files.values()]
    folders = {folder for path in inputs for folder in (path.parent.resolve(), path.resolve().parent)}
    if out.resolve() in folders or _identity(out) in {_identity(folder) for folder in folders}:
        raise InputError(f"{out}: this folder holds the input, which is never written to; choose another --out")
    identities = {_identity(path) for path in inputs}
    for name, _ in _written(sequence, layout, recombine):
        if (found := _identity(out / name)) and found in identities:
            raise InputError(f"{out / name}: is a file of the input, which is never written to; choose another --out")


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and number of a file or folder, links followed; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def output_names(sequence: Sequence, layout: str, recombine: bool) -> list[list[str]]:
    """The names of the files that a run writes for each frame."""
    return [[name for name, _ in frame] for frame in _files(sequence, layout, recombine)]


def _written(sequence: Sequence, layout: str, recombine: bool) -> Iterator[tuple[str, Path]]:
    """(name in the output folder, the input file that it is made from) of every file that a run writes."""
    return chain.from_iterable(_files(sequence, layout, recombine))


def _files(sequence: Sequence, layout: str, recombine: bool) -> Iterator[list[tuple[str, Path]]]:
    """`_written`, a list a frame."""
    if layout == "plain":
        yield from ([pair] for pair in zip(sequence.names, sequence.paths, strict=True))
        return
    beauty = sequence.layout.beauty_rule(sequence.header) if recombine else None
    channels = {*_place(sequence).channels, *(beauty.channels if beauty else ())}
    for files, path in zip(sequence.files, sequence.paths, strict=True):
        yield [(_name(file, path), file) for file in files.locate(channels)]


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
    rule = beauty or _place(sequence)
    ((file, names),) = sequence.files[index].locate(rule.channels).items()
    stored = read_channels(out / _name(file, path), tuple(names))
    return convert(rule, {full: stored[name] for name, full in names.items()}, "radiance")


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
    extra = {name: sequence.within(layer) for name, layer in extra.items()}
    image, beauty = (result if result is None else sequence.within(result) for result in (image, beauty))
    float32 = float32 or any(beyond_half(result) for result in (image, beauty) if result is not None)
    picture = image if sequence.signal == "color" and beauty is None else beauty
    covered = {} if picture is None else alpha_of(sequence, index, picture, alpha, coverage)
    if shutter:
        surface = frame.depth, frame.motion, frame.motion_next
        image = over_shutter(image, *surface, *shutter)
        covered = {name: over_shutter(plane[None, None], *surface, *shutter)[0, 0] for name, plane in covered.items()}
    if layout == "plain":
        result = image if beauty is None else beauty
        return _write_plain(out / sequence.names[index], sequence, index, result, covered, keep, float32, extra)
    planes = _planes(_place(sequence), image)
    if beauty is not None and (rule := sequence.layout.beauty_rule(sequence.header)):
        planes |= _planes(rule, beauty)
    if alpha != "rendered" or shutter:
        planes |= covered
    nans = {}
    for file, names in sequence.files[index].locate(planes).items():
        changed = {stored: planes[full] for stored, full in names.items()}
        nans |= write_like(out / _name(file, path), file, changed, dtype="float" if float32 else None)
    return nans


def alpha_of(
    sequence: Sequence,
    index: int,
    picture: np.ndarray,  # [1, 3, H, W] the denoised beauty
    alpha: str,  # of `ALPHAS`
    coverage: np.ndarray | None = None,  # [H, W] instead of what would be found
) -> dict[str, np.ndarray]:
    """The channel of a frame's alpha and its values `[H, W]` beside the denoised picture; empty where it has none."""
    stored = sequence.layout.alpha(sequence.header)
    if not stored or stored not in sequence.files[index].header().channels:
        return {}
    if coverage is None:
        plane = sequence.files[index].read([stored], as_stored=True)[stored]
        if alpha == "rendered":
            return {stored: plane}
        plane = sequence.region.mirrored(plane) if sequence.region else plane
        coverage = denoise_alpha(plane, np.moveaxis(picture[0], 0, 2))
    return {stored: sequence.within(coverage)}


def attributes_of(sequence: Sequence, index: int) -> dict[str, object]:
    """The header attributes of a file that is made from a frame's, for `write_layers`."""
    path = sequence.paths[index]
    return (read_attributes(path) if path.suffix.lower() == ".exr" else {}) | sequence.header.placing


def beyond_half(result: np.ndarray) -> bool:
    """Whether half floats do not hold values as large as a result's."""
    return bool(result.max() > MAX_HALF)


def _place(sequence: Sequence) -> Rule:
    """The channels of the input that the denoised signal replaces."""
    beauty = sequence.layout.beauty_rule(sequence.header) if sequence.signal == "color" else None
    return beauty or sequence.rules["radiance"]


def _name(file: Path, signal: Path) -> str:
    """The name of the output for `file`: its own, with its folder in front where the signal's file has the same."""
    return f"{file.parent.name}.{file.name}" if file != signal and file.name == signal.name else file.name


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
    passed = [name for name in _kept(sequence, keep) if name not in layers]  # the picture's alpha stands already
    layers |= file.read(passed, as_stored=True)
    dtypes |= {name: sequence.header.channels[name] for name in passed}
    write_layers(path, layers, dtypes=dtypes, attributes=attributes_of(sequence, index))
    return {
        name: bad
        for name, plane in layers.items()
        if name not in ("color", *extra) and (bad := int((plane != plane).sum()))
    }


def _kept(sequence: Sequence, keep: tuple[str, ...]) -> list[str]:
    """The channels that are passed on, without `R,G,B`, where the result stands.

    Each of `keep` is a layer or channel as the file calls it, with or without the view layer, a layer of `Frame` that
    the file has under whatever name, or 'all'. Raises InputError for what is none of these.
    """
    kept, channels = set(), sequence.header.channels
    layers = {channel: channel.rpartition(".")[0] for channel in channels}
    for name in keep:
        rule = sequence.available.get(name)
        found = {c for c, layer in layers.items() if name in ("all", c, layer, layer.rpartition(".")[2])}
        found = found or set(rule.channels if rule else ())
        if not found:
            raise InputError(f"{sequence.paths[0]}: no '{name}' to keep; the file has {sequence.header.summary}")
        kept |= found
    return [channel for channel in channels if channel in kept - {"R", "G", "B"}]
