"""Denoised frames beside the noisy ones they were made from: opening them, and finding out whether they belong
together."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..color import luminance
from ..data.layers import SIGNALS
from ..data.opening import open_sequence
from ..data.sequences import Sequence, convert
from ..errors import InputError
from ..files import read_json
from ..frame import Frame
from ..ops.block_luminance import block_luminance
from ..sanitise import sanitise
from .options import EXAMINED
from .summary import SUMMARY

MAX_RATIO = 1.6  # of the mean luminance of denoised and noisy frames, either way: noise moves it less, an f-stop more
WHITE = 1.001  # a tone-mapped picture ends at 1, up to rounding
BRIGHT = 1.25  # 8×8 means of the noisy frames above this are light that a picture ending at 1 has lost


def open_denoised(denoised: str, source: Sequence, preset: str, allow_gaps: bool) -> Sequence:
    """The denoised frames of `source`: in the channels where `denoise --layout source` writes them, or else in
    `R,G,B`.

    Raises InputError where they cannot be opened, are others than those of `source`, or have another size.
    """
    try:
        found = open_sequence(denoised, signal=source.signal, preset=preset, allow_gaps=allow_gaps)
        beauty = found.layout.beauty_rule(found.header) if source.signal == "color" else None
        found = replace(found, rules={"radiance": beauty or found.rules["radiance"]})
    except InputError:
        found = open_sequence(denoised, allow_gaps=allow_gaps)
        found = replace(found, rules={"radiance": found.rules["radiance"]})
    _check_frames(found, source, "denoised")
    return replace(found, beyond=source.beyond)


def open_second(second: str, source: Sequence, preset: str, allow_gaps: bool) -> Sequence:
    """Another render of `source`, where a renderer writes its noisy light. Raises InputError as `open_denoised`."""
    found = open_sequence(second, signal=source.signal, preset=preset, allow_gaps=allow_gaps).only(("radiance",))
    _check_frames(found, source, "second")
    return replace(found, beyond=source.beyond)


def _check_frames(found: Sequence, source: Sequence, kind: str) -> None:
    """Raise InputError where the frames of `found` are others than those of `source`, or have another size."""
    if found.size != source.size:
        (h, w), (H, W) = found.size, source.size
        wanted = "the frames that were denoised from them" if kind == "denoised" else "another render of them"
        raise InputError(f"{found.paths[0]}: is {w}×{h}, the noisy frames are {W}×{H}; name {wanted}")
    if alone := sorted(set(source.numbers) ^ set(found.numbers)):
        where, other = (source, kind) if alone[0] in source.numbers else (found, "noisy")
        raise InputError(f"{where.paths[0].parent}: frame {alone[0]} has no {other} frame: {len(source)} noisy frames, "
                         f"{len(found)} {kind} ones; both need the same frame numbers")  # fmt: skip


def read_estimate(denoised: Sequence, i: int) -> Tensor:
    """Denoised frame i, `[1, 3, H, W]` of `read_size`."""
    rule = denoised.rules["radiance"]
    return torch.from_numpy(convert(rule, denoised.planes(i, rule.channels), "radiance").astype(np.float32))


def read_alpha(denoised: Sequence, i: int) -> np.ndarray | None:
    """The alpha of denoised frame i, `[H, W]` of `read_size`; None where it has none."""
    channel = denoised.layout.alpha(denoised.header)
    return denoised.planes(i, [channel])[channel].clip(0, 1) if channel else None


def both(frame: Frame, second: Tensor) -> tuple[Frame, Tensor]:
    """A frame with the mean of two renders, and the light of the first one. Where a pixel is finite in one render
    alone, the mean is its value there, and the light NaN: nothing tells its noise apart."""
    first = frame.radiance
    known, other = (x.isfinite().all(1, keepdim=True) for x in (first, second))
    mean = torch.where(known & other, (first + second) / 2, first.where(known, second))
    samples = None if frame.samples is None else frame.samples * (1.0 + (known & other))
    return replace(frame, radiance=mean, samples=samples), first.where(known & other, torch.nan)


def check_other(source: Sequence, denoised: Sequence) -> None:
    """Raise InputError where the denoised frames are the noisy ones, read from the same channels of the same files."""
    channels = source.rules["radiance"].channels
    if denoised.paths == source.paths and denoised.rules["radiance"].channels == channels:
        raise InputError(f"{source.paths[0]}: {', '.join(channels)} was named as noisy and as denoised frame; name the "
                         "folder of the denoised frames")  # fmt: skip


def check_signal(source: Sequence, denoised: Sequence) -> None:
    """Raise InputError where a run of `denoise` or `combine` tells beside the denoised frames that they hold another
    signal."""
    path, options = denoised.paths[0].parent / SUMMARY, {}
    with suppress(InputError, AttributeError):  # there is none, or it is of another program
        options = read_json(path).get("options", {})
    if not isinstance(options, dict) or str(options.get("signal")) not in SIGNALS:
        return
    beauty = ["color"] if options.get("recombine") else []
    held = beauty if beauty and options.get("layout") == "plain" else [options["signal"], *beauty]
    if source.signal not in held:
        raise InputError(f"{path}: the denoised frames are of the signal {held[0]}, expected {source.signal}; name "
                         f"others, or pass --signal {held[0]}")  # fmt: skip


def check_second(source: Sequence, second: Sequence, denoised: Sequence) -> None:
    """Raise InputError where the second render repeats the first one, as its noise must be another, or the denoised
    frames, which have none."""
    if repeats(source, second):
        raise InputError(f"{second.paths[0]}: is the same picture as {source.paths[0]}; render the second one with "
                         "another seed")  # fmt: skip
    if are_same((read_estimate(denoised, i).numpy(), read_estimate(second, i).numpy()) for i in _places(source)):
        raise InputError(f"{second.paths[0]}: is the same picture as {denoised.paths[0]}, which is denoised; --second "
                         "is a noisy render")  # fmt: skip


def repeats(source: Sequence, other: Sequence) -> bool:
    """Whether `other` shows the same light. The first, the middle and the last frame are compared; one without light
    tells nothing."""
    noisy = source.only(("radiance",))
    return are_same((noisy.read(i).radiance, read_estimate(other, i).numpy()) for i in _places(source))


def _places(source: Sequence) -> list[int]:
    return sorted({0, len(source) // 2, len(source) - 1})


def are_same(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether the pictures of each pair are the same, and not all without light."""
    pairs = list(pairs)
    return any(np.any(a) for a, _ in pairs) and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def check_pairs(source: Sequence, denoised: Sequence, kind: str = "denoised") -> None:
    """Compare the light of the first `EXAMINED` frames, where both are finite. Raises InputError where the denoised
    ones, or those of another `kind`, are tone-mapped or have another exposure."""
    places = range(min(EXAMINED, len(source)))
    noisy = torch.cat([torch.from_numpy(source.only(("radiance",)).read(i).radiance) for i in places])
    clean = torch.cat([read_estimate(denoised, i) for i in places])
    known = noisy.isfinite().all(1, keepdim=True) & clean.isfinite().all(1, keepdim=True)
    noisy, clean = (_light(image.where(known, 0)) for image in (noisy, clean))
    path, brightest = denoised.paths[0], block_luminance(noisy, 8)[0].max().item()
    if clean.max() <= WHITE and clean.max() > 0.9 and brightest > BRIGHT:
        raise InputError(f"{path}: the {kind} light ends at {clean.max():.2f}, the noisy light reaches "
                         f"{brightest:.1f} over 8×8 pixels: it looks tone-mapped, or is another "
                         "signal; save the same one as linear light")  # fmt: skip
    ratio = (luminance(clean).mean().item() + 1e-12) / (luminance(noisy).mean().item() + 1e-12)
    if not 1 / MAX_RATIO <= ratio <= MAX_RATIO:
        raise InputError(f"{path}: the {kind} frames are {ratio:.3g} times as bright as the noisy ones; both need "
                         "the same exposure, in linear light")  # fmt: skip


def _light(image: Tensor) -> Tensor:
    """Without values that no filter can use, and without fireflies."""
    return sanitise(Frame(image)).radiance
