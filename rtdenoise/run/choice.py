"""Which network for which frames, where the user names none. Needs no torch."""

from __future__ import annotations

from dataclasses import replace

from ..data.sequences import Sequence, open_sequence
from .options import AUTO, Options

FEW, MANY = "default", "many"
LEAST = 4  # samples a pixel from which `many` is better (docs/results/held.md)


def open_chosen(source: str, options: Options, layers: tuple[str, ...] = ()) -> tuple[Sequence, Options, list[str]]:
    """The sequence, with these optional layers; the options with a network in place of 'auto'; what to tell about it.

    The number of samples is that of the layer `samples`, of `options.samples`, or what the renderer noted in the files.
    Raises InputError as `open_sequence` and reading the first frame do.
    """
    auto = options.model == AUTO
    sequence = open_sequence(
        source, signal=options.signal, preset=options.preset, layers=(*layers, *(["samples"] if auto else [])),
        allow_gaps=options.allow_gaps,
    )  # fmt: skip
    if not auto:
        return sequence, options, []
    samples = _known_samples(sequence, options)
    if "samples" not in layers:
        sequence = sequence.only(sequence.rules.keys() - {"samples"})
    if samples < LEAST:
        return sequence, replace(options, model=FEW), []
    return sequence, replace(options, model=MANY), [f"model: {MANY}, for {samples:g} samples a pixel"]


def _known_samples(sequence: Sequence, options: Options) -> float:
    """Samples a pixel of the first frame; 0: unknown."""
    if "samples" not in sequence.rules:
        return options.samples or sequence.header.samples
    return float(sequence.only({"radiance", "samples"}).read(0).samples.mean())
