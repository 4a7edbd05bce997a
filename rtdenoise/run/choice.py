"""Which network for which frames, where the user names none. Needs no torch."""

from __future__ import annotations

from dataclasses import replace

from ..data.sequences import open_sequence
from .options import AUTO, Options

FEW, MANY = "default", "many"
LEAST = 4  # samples a pixel from which `many` is better (docs/results/held.md)


def choose_model(source: str, options: Options) -> tuple[Options, list[str]]:
    """The options with a network in place of 'auto', and what to tell about it.

    The number of samples is that of the layer `samples`, of `options.samples`, or what the renderer noted in the files.
    Raises InputError as `open_sequence` and reading the first frame do.
    """
    if options.model != AUTO:
        return options, []
    samples = known_samples(source, options)
    if samples < LEAST:
        return replace(options, model=FEW), []
    return replace(options, model=MANY), [f"model: {MANY}, for {samples:g} samples a pixel"]


def known_samples(source: str, options: Options) -> float:
    """Samples a pixel of the first frame; 0: unknown."""
    sequence = open_sequence(
        source, signal=options.signal, preset=options.preset, layers=("samples",), allow_gaps=options.allow_gaps
    )
    if "samples" not in sequence.rules:
        return options.samples or sequence.header.samples
    return float(sequence.only({"radiance", "samples"}).read(0).samples.mean())
