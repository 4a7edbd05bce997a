"""Which network for which frames, and how many frames ahead, where the user names none. Needs no torch."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

from ..data.lost import lost_samples
from ..data.opening import open_sequence
from ..data.region import find_region
from ..data.sequences import Sequence
from ..models.hybrid_config import HybridConfig
from ..models.weights import read_config
from .lens_motion import with_lens_if_lacking
from .options import AHEAD, AUTO, FEW_AHEAD, MANY_AHEAD, MIXED, Options
from .panorama import with_panorama
from .surfaces import with_surfaces

BEST = "hybrid", "hybrid-many"  # for few samples a pixel and for many: the best picture in OIDN's time
CLEAN = "hybrid-large", "hybrid-large-many"  # where there is time: their networks clean albedo and normal first
KERNELS = "default", "many"  # kernels alone, for all that goes with these only
LEAST = 4  # samples a pixel from which those for many are better (docs/results/held.md)
LOST = 0.004  # share of samples that are lost, as in water and glass, from which few are better off with CLEAN, too
LITTLE = 0.08  # `exposure.noise_level`: below, a frame of unknown samples has many (docs/notes/lookahead.md)


def open_chosen(source: str, options: Options, layers: tuple[str, ...] = ()) -> tuple[Sequence, Options, list[str]]:
    """The sequence, with these optional layers; the options with a network, and frames ahead, in place of 'auto'; what
    to tell about it.

    The number of samples is that of the layer `samples`, of `options.samples`, or what the renderer noted in the files;
    where none is known, the noise of the first frame tells; of few, the samples that are lost in it. Frames of one
    sample from Cycles have soft edges, unless there are `options.surfaces`; those of less than MIXED are read
    `with_lost_samples` and `with_veiled`, frames of all renderers `with_virtual_motion`, and whatever their samples
    `with_fog`, unless the options are off.
    Raises InputError as `open_sequence`, reading the first frame, and `with_lens_if_lacking` do.
    """
    auto = options.model == AUTO
    sequence = open_sequence(
        source, signal=options.signal, preset=options.preset, layers=(*layers, *(["samples"] if auto else [])),
        allow_gaps=options.allow_gaps,
    )  # fmt: skip
    sequence, joined = with_panorama(with_surfaces(sequence, options), options)
    if options.motion_blur:
        sequence.require("depth", "motion")
    sequence, options, notes = with_lens_if_lacking(sequence, options)
    notes = [*joined, *notes]
    sequence = with_region(sequence)
    cycles = sequence.layout.name == "cycles" and sequence.signal == "color"
    if options.samples == sequence.header.samples:
        options = replace(options, samples=0)  # what the files say, too, is the same run without
    samples = known_samples(sequence, options.samples)
    virtual = options.virtual_motion and sequence.signal == "color"  # indirect light ends at mirrors and panes
    fog = options.fog and sequence.signal == "color"  # indirect light is divided by the colour of what was hit
    sequence = replace(
        sequence, soft_edges=cycles and samples == 1 and not sequence.surfaces,
        virtual_motion=virtual and samples < MIXED, fog=fog, few_samples=0 < samples < MIXED,
        lost_samples=cycles and samples < MIXED, veiled=sequence.layout.name == "cycles" and samples < MIXED,
    )  # fmt: skip
    if not auto:
        return sequence, _with(options, options.model), notes
    if "samples" not in layers:
        sequence = replace(sequence, rules={k: rule for k, rule in sequence.rules.items() if k != "samples"})
    few, many = candidates(options.backend, options.correct)
    best = (few, many) == BEST
    waits = not options.offline if options.lookahead == AUTO else options.lookahead > 0
    if best and (waits or (options.offline and cycles)):  # docs/notes/many.md, docs/notes/offline.md
        many = CLEAN[1]
    because = f", because of {_reason(options)}" if (few, many) == KERNELS else ""
    if not samples and _has_little_noise(sequence):
        told = f"model: {many}, for frames of little noise{because}; --samples 1 says otherwise"
        return sequence, _with(options, many), [*notes, told]
    if samples >= LEAST:
        told = f"model: {many}, for {samples:g} samples a pixel{because}"
        return sequence, _with(options, many), [*notes, told]
    if best and (waits or options.offline) and (lost := _share_of_lost_samples(sequence)) > LOST:
        told = f"model: {CLEAN[0]}, because {lost:.1%} of the samples are lost, as in water and glass"
        return sequence, _with(options, CLEAN[0]), [*notes, f"{told}; --model {few} is faster"]
    return sequence, _with(options, few), [*notes, *([f"model: {few}{because}"] if because else [])]


def _with(options: Options, model: str) -> Options:
    """The options with a network, and with its frames ahead where they are 'auto'."""
    options = replace(options, model=model)
    return replace(options, lookahead=_ahead(options)) if options.lookahead == AUTO else options


def _ahead(options: Options) -> int:
    """How many frames the network that `options` names looks ahead where nothing is said: none unless it writes pixels,
    as those of 'auto'. Raises InputError where there is no such network."""
    if options.offline or options.correct or not _in_torch(options.backend):
        return 0
    config = read_config(options.model)
    if not isinstance(config, HybridConfig):
        return 0
    if options.lights or options.also:
        return FEW_AHEAD
    return MANY_AHEAD if config.many else AHEAD


def _reason(options: Options) -> str:
    """What keeps the networks that write pixels from being chosen."""
    if options.correct:
        return "--correct"
    return "--backend glsl" if options.backend == "glsl" else "the backend glsl: PyTorch is not installed"


def candidates(backend: str, correct: bool) -> tuple[str, str]:
    """The networks that make the best picture in OIDN's time on a backend, of few samples a pixel and from LEAST on:
    those that write pixels, unless their images are to be corrected, which goes with kernels alone."""
    return BEST if _in_torch(backend) and not correct else KERNELS


def _in_torch(backend: str) -> bool:
    return backend == "torch" or (backend == "auto" and find_spec("torch") is not None)


def _has_little_noise(sequence: Sequence) -> bool:
    """Whether the first frame does. False without torch, and where depth is missing."""
    if not sequence.has("depth") or find_spec("torch") is None:
        return False
    import torch

    from ..exposure import noise_level
    from ..sanitise import sanitise

    frame = sanitise(sequence.only({"radiance", "depth"}).read(0).map(torch.as_tensor))
    return noise_level(frame.radiance, frame.depth).item() < LITTLE


def _share_of_lost_samples(sequence: Sequence) -> float:
    """In the first frame, where they are looked for."""
    if not sequence.lost_samples or not (sequence.has("albedo") and sequence.has("depth")):
        return 0.0
    lost = lost_samples(as_rendered(sequence).only({"radiance", "albedo", "depth"}).read(0))
    return 0.0 if lost is None else float(lost.mean())


def as_rendered(sequence: Sequence) -> Sequence:
    """The sequence without what is mended in layers of Cycles."""
    return replace(sequence, soft_edges=False, virtual_motion=False, fog=False, lost_samples=False, veiled=False)


def with_region(sequence: Sequence) -> Sequence:
    """The sequence with the render region of its first frame, where Blender has not cropped files to it."""
    if sequence.beyond or sequence.layout.name != "cycles" or sequence.surfaces or "depth" not in sequence.available:
        return sequence
    (channel,) = sequence.available["depth"].channels
    return replace(sequence, beyond=find_region(sequence.files[0].read([channel])[channel]))


def known_samples(sequence: Sequence, given: int) -> float:
    """Samples a pixel of the first frame: of its layer `samples`, or `given`, or as the file notes them; 0: unknown."""
    if "samples" not in sequence.rules:
        return given or sequence.header.samples
    return float(sequence.only({"radiance", "samples"}).read(0).samples.mean())


def told_of_samples(sequence: Sequence, given: int) -> list[str]:
    """A line where the user's samples a pixel are not those that the headers note."""
    noted = sequence.header.samples
    if not (given and noted and given != noted):
        return []
    return [f"--samples {given}: counts, though the files say {noted}; leave it out if they are right"]
