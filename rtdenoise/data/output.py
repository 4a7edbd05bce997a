"""A denoised frame as a file: in `R,G,B`, or in the place that the signal has in the renderer's own file; alone, or
recombined with the rest of the light.

With S the noisy signal, D the denoised one, C the noisy beauty and A what the renderer has divided the signal by (1
where it has not), the recombined beauty is

    signal color      D · A
    signal indirect   C + (D − S) · A

The second is the sum of all lights with the denoised indirect light in the place of the noisy one: Cycles' Combined is
Σ (direct + indirect) · color over diffuse, glossy and transmission, plus emission and environment, and what is not
S · A cancels out. It needs none of those passes, and stays right where a scene has more of them (volumes).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..frame import Frame
from ..sanitise import sanitise
from .exr import read_channels, write_layers, write_like
from .layout import Rule
from .sequences import Sequence, convert

if TYPE_CHECKING:
    from torch import Tensor

LAYOUTS = ("plain", "source")
NOTHING: Mapping[str, np.ndarray] = MappingProxyType({})
PLAIN = Rule(("R", "G", "B"), (1, 1, 1))


def check_output(sequence: Sequence, layout: str, recombine: bool, keep: tuple[str, ...]) -> None:
    """Raise `InputError` for what cannot be written, before anything is denoised."""
    if layout not in LAYOUTS:
        raise InputError(f"unknown layout '{layout}': known are {', '.join(LAYOUTS)}")
    if layout == "source" and sequence.paths[0].suffix.lower() != ".exr":
        raise InputError(f"{sequence.paths[0]}: layout 'source' copies EXR files, this is none: choose 'plain'")
    if layout == "source" and keep:
        raise InputError("layout 'source' passes every channel on: leave --keep out")
    if recombine and find_spec("torch") is None:
        raise InputError("--recombine needs PyTorch, which is not installed; leave it out")
    if recombine and sequence.signal != "color" and "radiance" not in sequence.layout.resolve(sequence.header, "color"):
        raise InputError(f"{sequence.paths[0]}: --recombine needs the beauty, the file has {sequence.header.summary}; "
                         f"{sequence.layout.hint('radiance', 'color')}")  # fmt: skip
    if recombine and sequence.demodulated and "albedo" not in sequence.rules:
        raise InputError(f"{sequence.paths[0]}: --recombine needs the albedo that the signal was divided by; "
                         f"{sequence.layout.hint('albedo', sequence.signal)}")  # fmt: skip


def recombined(sequence: Sequence, index: int, frame: Frame, image: Tensor) -> Tensor:
    """The beauty `[1, 3, H, W]` with the denoised signal `image` in it; the equation stands above. Never negative;
    where the input is not finite, the rest counts as 0."""
    import torch

    albedo = sanitise(frame).albedo if sequence.demodulated else torch.ones_like(image)
    if sequence.signal == "color":
        return image * albedo
    rule = sequence.layout.resolve(sequence.header, "color")["radiance"]
    color = torch.from_numpy(convert(rule, sequence.files[index].read(rule.channels), "radiance"))
    rest = torch.nan_to_num(color - frame.radiance * albedo, nan=0.0, posinf=0.0, neginf=0.0)
    return (rest + image * albedo).clamp(min=0)


def read_result(
    out: Path, sequence: Sequence, index: int, layout: str = "plain", recombine: bool = False
) -> Tensor:  # [1, 3, H, W]
    """What `write_frame` wrote with these options: the denoised signal, or the beauty."""
    import torch

    path = sequence.paths[index]
    if layout == "plain":
        plain = read_channels(out / sequence.names[index], PLAIN.channels)
        return torch.from_numpy(convert(PLAIN, plain, "radiance"))
    beauty = sequence.layout.beauty_rule(sequence.header) if recombine else None
    rule = beauty or _place(sequence)
    ((file, names),) = sequence.files[index].locate(rule.channels).items()
    stored = read_channels(out / _name(file, path), tuple(names))
    return torch.from_numpy(convert(rule, {full: stored[name] for name, full in names.items()}, "radiance"))


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
    float32: bool = False,
    extra: Mapping[str, np.ndarray] = NOTHING,  # layer -> [1, C, H, W], written too; plain layout only
) -> None:
    """Write one frame under the name of the input file that holds the signal.

    plain    the signal in `R,G,B`, with `recombine` the beauty instead, and what is kept
    source   every channel of the input under its name and in its part, the denoised signal in the place of the noisy
             one, with `recombine` also the beauty in the place of the renderer's. Where buffers are files of their own,
             those alone that have changed.
    """
    beauty = None
    if recombine:
        import torch

        beauty = recombined(sequence, index, frame.map(torch.from_numpy), torch.from_numpy(image)).numpy()
    path = sequence.paths[index]
    if layout == "plain":
        shown = image if beauty is None else beauty
        _write_plain(out / sequence.names[index], sequence, index, shown, keep, float32, extra)
        return
    planes = _planes(_place(sequence), image)
    if beauty is not None and (rule := sequence.layout.beauty_rule(sequence.header)):
        planes |= _planes(rule, beauty)
    for file, names in sequence.files[index].locate(planes).items():
        changed = {stored: planes[full] for stored, full in names.items()}
        write_like(out / _name(file, path), file, changed, dtype="float" if float32 else None)


def _place(sequence: Sequence) -> Rule:
    """The channels of the input that the denoised signal replaces."""
    beauty = sequence.layout.beauty_rule(sequence.header) if sequence.signal == "color" else None
    return beauty or sequence.rules["radiance"]


def _name(file: Path, signal: Path) -> str:
    """What the output for `file` is called: its name, unless the signal's file in another folder has the same."""
    return f"{file.parent.name}.{file.name}" if file != signal and file.name == signal.name else file.name


def _planes(rule: Rule, image: np.ndarray) -> dict[str, np.ndarray]:
    """The inverse of `convert` for radiance."""
    return {name: sign * plane for name, sign, plane in zip(rule.channels, rule.signs, image[0], strict=True)}


def _write_plain(
    path: Path,
    sequence: Sequence,
    index: int,
    image: np.ndarray,
    keep: tuple[str, ...],
    float32: bool,
    extra: Mapping[str, np.ndarray],
) -> None:
    layers = {name: np.moveaxis(array[0], 0, 2) for name, array in {"color": image, **extra}.items()}
    dtypes = {"color": "float" if float32 else "half"}
    if keep:
        types = sequence.header.channels
        names = [name for name in types if name not in ("R", "G", "B") and _kept(name, keep)]
        if not names:
            raise InputError(f"{sequence.paths[index]}: no channel of {', '.join(keep)} to keep; the file has "
                             f"{', '.join(types)}")  # fmt: skip
        layers |= sequence.files[index].read(names)
        dtypes |= {name: types[name] for name in names}
    write_layers(path, layers, dtypes=dtypes)


def _kept(channel: str, keep: tuple[str, ...]) -> bool:
    return "all" in keep or channel.rpartition(".")[0] in keep or channel in keep
