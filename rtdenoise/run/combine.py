"""Correct denoised frames by the noisy ones they were made from: `rtdenoise combine NOISY DENOISED --out DIR`.

The denoised frames may come from any denoiser. A combiner (`models.combiner`) takes each with the noisy frame and both
of its neighbours in time, and writes it in the place and layout that `denoise` would write it in. Five frames are in
memory at a time. A run that was interrupted goes on where it stopped; frames appended since count as neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ..data.opening import open_sequence
from ..data.output_files import check_output, protect_input
from ..data.sequences import Sequence
from ..errors import InputError
from ..files import lock, remove_unfinished
from .choice import told_of_samples
from .folder import conclude, prepare
from .lens_motion import with_lens_if_lacking
from .options import CombineOptions, check_samples
from .panorama import with_panorama
from .summary import Summary
from .surfaces import with_surfaces

if TYPE_CHECKING:
    from ..models import Combiner, Shrinkage

FEATURES = ("albedo", "normal", "depth")


def combine(
    noisy: str,
    denoised: str,
    out: str | Path,
    options: CombineOptions = CombineOptions(),
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Correct every frame of `denoised` (folder or glob) into `out`, under the name of its noisy file.

    `denoised` holds the same frames as `noisy`, in the place that `denoise` writes them to: `R,G,B`, or the finished
    picture in the renderer's own layout. Layers that the noisy files lack are done without; the summary's notes name
    them. `on_frame(done, total)` is called at the start and after each frame.

    Raises InputError where both are the same channels of the same files, frames of one are missing in the other, sizes
    or exposures differ, the denoised frames are tone-mapped, and for anything else wrong with the input, the options or
    the output folder.
    """
    if find_spec("torch") is None:
        raise InputError("combine needs PyTorch, which is not installed")
    check_samples(options.samples)
    from ..models import load_combiner
    from ..models.inference import choose_device
    from .correcting import Run
    from .pairs import check_other, check_pairs, check_second, check_signal, open_denoised, open_second, repeats

    source = open_sequence(
        noisy, signal=options.signal, preset=options.preset, layers=("samples",), allow_gaps=options.allow_gaps
    )
    source, joined = with_panorama(with_surfaces(source, options), options)
    source, options, found = with_lens_if_lacking(source, options)
    estimates = open_denoised(denoised, source, options.preset, options.allow_gaps)
    check_output(source, options.layout, options.recombine, options.keep, options.alpha, options.confidence)
    check_other(source, estimates)
    check_signal(source, estimates)
    check_pairs(source, estimates)
    second = open_second(options.second, source, options.preset, options.allow_gaps) if options.second else None
    if second:
        check_second(source, second, estimates)
        check_pairs(source, second, "second")
    same = f"{estimates.paths[0]} is the same picture as {source.paths[0]}: name the denoised frames"
    notes = [*joined, *found, *([same] if repeats(source, estimates) else [])]
    device = choose_device(options.device)
    combiner = load_combiner(options.model, device, options.precision)
    for one in (estimates, *([second] if second else [])):
        protect_input(one, Path(out), "plain", False)
    out = prepare(Path(out), source, options)
    with lock(out):
        remove_unfinished(out)
        run = Run(source, estimates, second, out, options, combiner, device, on_frame)
        notes += unread_options(options, combiner) + missing_layers(source, options, combiner)
        notes += told_of_samples(source, options.samples) if _by_evidence(combiner) else []
        summary = run.run(overwrite, notes)
        conclude(out, source, options, [], summary)
    return summary


def unread_options(options: CombineOptions, combiner: Combiner | Shrinkage) -> list[str]:
    """The options that a network without evidence does without, a line each."""
    if _by_evidence(combiner):
        return []
    lines = {
        f"{options.model} takes the mean of both renders, and does not read their differences": options.second,
        f"{options.model} reads no --samples": options.samples,
    }
    return [line for line, given in lines.items() if given]


def missing_layers(source: Sequence, options: CombineOptions, combiner: Combiner | Shrinkage) -> list[str]:
    """What the noisy files lack and what that costs, a line each."""
    lacking = [layer for layer in FEATURES if not source.has(layer)]
    lines = [f"the noisy files have no {', '.join(lacking)}: corrected without"] if lacking else []
    alone = "there is one frame" if len(source) == 1 else "" if source.has("motion") else "the files have no motion"
    if alone and _by_evidence(combiner) and not options.second:
        return [*lines, f"{alone}: nothing is corrected; a second render (--second) would be needed"]
    if len(source) > 1 and not source.has("motion"):
        return [*lines, "the noisy files have no motion: every frame is corrected by itself alone"]
    if len(source) > 1 and not source.has("motion_next"):
        instead = "it is approximated from motion and depth" if source.has("depth") else "frames after are not used"
        lines.append(f"the noisy files have no motion_next: {instead}")
    return lines


def _by_evidence(combiner: Combiner | Shrinkage) -> bool:
    """Whether it corrects what independent noisy frames agree on, and nothing else."""
    config = getattr(combiner, "config", None)
    return config is None or config.evidence
