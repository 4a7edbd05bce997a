"""Denoise a sequence of EXR files into a folder: `rtdenoise denoise SEQ --out DIR`. Interrupted runs go on where they
stopped, and finished runs where frames were appended."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..constants import SOFTWARE_RENDERER
from ..data.numbering import told_of_order
from ..data.opening import open_sequence
from ..data.output import write_frame
from ..data.output_files import check_output, output_names
from ..data.sequences import Sequence
from ..errors import InputError
from ..files import lock, remove_unfinished
from ..frame import Frame
from ..models.weights import read_config
from .backends import Backend, open_backend
from .behind import Behind
from .choice import open_chosen, told_of_samples
from .coming import Reader
from .folder import Written, are_finished, conclude, digest, prepare, refuse_foreign, refuse_other
from .following import Following
from .in_parts import in_parts
from .lookahead import direct
from .offline_picture import Picture
from .options import AUTO, EXAMINED, Options, check, of_output
from .shadows import LEFT, find_shadows, open_shadows
from .stand_ins import told_of_missing, with_stand_ins
from .state import STATE, Due, finish_state, last_of_shot, read_state, save_state
from .summary import Summary, add
from .unmoved import Watch

BLURS = "depth", "motion", "motion_next"  # what --motion-blur reads


def denoise(
    source: str,
    out: str | Path,
    options: Options = Options(),
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Denoise every frame of `source` (folder or glob) into `out`, one file of the same name each; see `data.output`
    for what is in it.

    Frames that an earlier run with the same options has finished are skipped (of large pictures all but the last ones,
    `state.Due`), and history goes on from its saved state, so the outcome is that of one undisturbed run: also where it
    was interrupted, and where frames have been appended to the input since. `on_frame(done, total)` is called at the
    start and after each frame.

    With `options.lookahead` the last frames that lacked some of those after them are denoised again once frames have
    been appended. With `offline` appended frames change all before them, so that a finished run is not continued:
    `overwrite` starts anew.

    With `options.offline` see `offline.denoise_offline`: there `total` counts the frames of both passes. With light in
    parts, too, see `offline_picture`: it counts the frames three times.

    Raises InputError for anything wrong with the input, the options or the output folder.
    """
    check(options)
    in_passes, picture = bool(options.lights or options.also), None
    channel = _shadows_in(source, options) if options.offline and not in_passes else None  # None: not looked for yet
    if options.offline and (in_passes or (channel and not _is_final(options))):
        picture = Picture(source, Path(out), options, overwrite, on_frame)
        options, on_frame = picture.options_of_light, picture.on_frame_of_light
    elif options.offline:
        from .offline import denoise_offline

        summary = denoise_offline(source, out, options, overwrite, on_frame)
        summary.notes += [LEFT.format(f"--offline with {_is_final(options)}")] if channel else []
        return summary
    reads = () if options.model == AUTO else read_config(options.model).reads
    layers = (*reads, *(["samples"] if options.correct else []))
    sequence, options, notes = open_chosen(source, options, layers)
    sequence.require(*reads)
    check_output(sequence, options.layout, options.recombine, options.keep, options.alpha)
    backend = open_backend(
        options.backend,
        options.model,
        options.device,
        options.precision,
        options.correct,
        lookahead=options.lookahead,
    )
    notes += _notes(sequence, options, backend) + told_of_samples(sequence, options.samples)
    notes += told_of_missing(sequence, backend.config.motion is not None, source)
    channel = find_shadows(sequence, options) if channel is None else channel
    shadows, told = open_shadows(channel, options, backend)
    notes += told
    write = partial(write_frame, **of_output(options))
    read = _read
    if not (in_passes or shadows):
        backend = Following(backend, options.detect_exposure)
    else:
        if reads:
            raise InputError(f"--lights, --also: not with {options.model}, which reads {reads[0]}; "
                             "leave them out, or take --model default")  # fmt: skip
        backend, read, write = in_parts(sequence, options, backend, picture, shadows)
    out = prepare(Path(out), sequence, options)
    with lock(out):
        remove_unfinished(out)
        summary = _run(sequence, out, options, backend, read, write, overwrite, on_frame, picture)
        if picture:
            picture.remove(sequence)
        conclude(out, sequence, options, notes, summary)
    return summary


def _run(
    sequence: Sequence,
    out: Path,
    options: Options,
    backend: Backend,
    read: Callable[[Sequence, int], Frame],
    write: Callable[..., dict[str, int]],
    overwrite: bool,
    on_frame: Callable[[int, int], None],
    picture: Picture | None,
) -> Summary:
    fingerprints, reach = digest(sequence, options), options.lookahead
    if picture:  # appended frames change what all before them look like
        fingerprints = [fingerprints[-1]] * len(fingerprints)
    done, history, summary = (
        (0, None, Summary()) if overwrite else _resume(out, sequence, fingerprints, backend, options)
    )
    if not done:  # so that the next run knows the first frame for its own
        save_state(out / STATE, {}, 0, fingerprints[0], summary, options)
    summary.skipped, summary.gaps, summary.ran = done, list(sequence.gaps), backend.ran
    names = output_names(sequence, options.layout, options.recombine)
    written = Written(out, names[:done])
    if picture and done < len(sequence):
        made = picture.make(sequence)
        summary.notes, summary.seconds = [*summary.notes, *made.notes], summary.seconds + made.seconds
    if options.plan:
        first = [sequence.read(i) for i in range(min(EXAMINED, len(sequence)))]
        summary.plan = backend.plan(sequence.read_size, len(sequence), first, summary.left_out)
    if history is not None:
        recent = last_of_shot(sequence, done, summary.cuts, backend.config.recent + 1)
        history = backend.remember(history, [backend.prepare(with_stand_ins(read(sequence, i))) for i in recent])
    if summary.plan:
        others = (*(["samples"] if options.correct else []), *(BLURS if options.motion_blur else []))
        sequence = sequence.only({*summary.plan.layers, *others})

    on_frame(done, len(sequence))

    def frame(i: int) -> Frame:
        found = read(sequence, i)
        return found.with_samples(options.samples or sequence.header.samples) if options.correct else found

    def finish(i: int, raw: Frame, image: Any, so_far: Summary | None, save: Callable | None) -> dict[str, int]:
        """Write a frame, and the state after it; `so_far` lacks what was passed on of it."""
        passed_on = write(out, sequence, i, raw, image)
        written.add(names[i])
        if save:
            add(so_far.passed_on, passed_on)
            save(summary=so_far, written=written.digest)
        return passed_on

    def finished(passed_on: dict[str, int]) -> None:
        add(summary.passed_on, passed_on)
        summary.written += 1
        on_frame(done + summary.written, len(sequence))

    spent, watch, due = summary.seconds, Watch(summary.notes), Due(sequence.size)
    last = len(sequence) - reach - 1  # no frame that is appended changes this one and those before

    def hand_over(i: int, raw: Frame, image: Any, history: Any, left_out: dict[str, int]) -> None:
        """Let a frame be finished while the next one is denoised. `left_out`: as in the summary after its step."""
        behind.wait()
        save = so_far = None
        if i <= last and due.now(i == last):
            state, mark = backend.save(history), fingerprints[i + 1 + reach]
            so_far = replace(deepcopy(summary), left_out=left_out)
            save = partial(save_state, out / STATE, state, i + 1, mark, options=options)
        behind.start(partial(finish, i, raw, image, so_far, save))

    on, detects = direct(backend, reach), options.detect_cuts
    with Reader(frame, sequence.numbers, backend, on, detects) as reader, Behind(finished) as behind:
        waits = None  # the frame before, and its image, where this frame's settles it
        for i in range(done, len(sequence)):
            this, ahead = reader.take(i, history)
            started, left_out = time.perf_counter(), dict(summary.left_out)
            image, after = backend.step(this.prepared, history if this.goes_on else None, ahead)
            if waits and this.goes_on:
                settled = backend.settled(waits[0].prepared, history, this.prepared, after)
                waits = waits[0], settled.cpu().numpy()
            spent += time.perf_counter() - started
            if waits:
                hand_over(i - 1, waits[0].raw, waits[1], history, left_out)
            history = after
            add(summary.replaced, this.faults)
            watch.see(this.raw, this.goes_on)
            if this.cut:
                summary.cuts.append(this.raw.number)
            summary.seconds = spent + reader.seconds
            summary.exposure[i:] = [backend.gain(history)]
            if backend.settles:
                waits = this, image
            else:
                hand_over(i, this.raw, image, history, dict(summary.left_out))
        if waits:
            hand_over(i, waits[0].raw, waits[1], history, dict(summary.left_out))
    seen = len(summary.notes)
    watch.end(len(sequence), len(summary.cuts))
    if done < len(sequence) and (reach or len(summary.notes) > seen):
        finish_state(out / STATE, fingerprints[-1], summary, written.digest)
    return summary


def _shadows_in(source: str, options: Options) -> str:
    """As `find_shadows`, before it is known how the sequence is read."""
    chosen = {name: getattr(options, name) for name in ("signal", "preset", "allow_gaps")}
    return find_shadows(open_sequence(source, **chosen), options)


def _is_final(options: Options) -> str:
    """The option for which a picture by all frames is written as it is to be, and no other follows; "" for none."""
    final = "recombine", "confidence", "motion_blur"
    return next((f"--{name.replace('_', '-')}" for name in final if getattr(options, name)), "")


def _read(sequence: Sequence, i: int) -> Frame:
    return sequence.read(i)


def _notes(sequence: Sequence, options: Options, backend: Backend) -> list[str]:
    """What the user should know of the choice of model, device and options."""
    notes, device = told_of_order(sequence.numbers), backend.ran["device"]
    if SOFTWARE_RENDERER in device:
        notes.append(f"the shaders run on the CPU, by {device}: PyTorch (--backend torch) is many times as fast")
    if len(sequence) > 1 and backend.config.motion is None:
        notes.append(f"{options.model} denoises each frame alone: nothing is carried from frame to frame")
    if len(sequence) == 1 and options.correct:
        notes.append("--correct: there is one frame, and the correction needs the frames before")
    return notes


def _resume(
    out: Path, sequence: Sequence, fingerprints: list[str], backend: Backend, options: Options
) -> tuple[int, Any, Summary]:
    """How many frames are finished, the history after them, and what there was to say about them."""
    names = output_names(sequence, options.layout, options.recombine)
    if not (out / STATE).exists():
        refuse_foreign(out, names)
        return 0, None, Summary()
    done, history, summary, metadata = read_state(out / STATE, backend)
    finished = metadata["finished"]
    same = finished and finished["fingerprint"] == fingerprints[-1]
    if same and are_finished(out, names, sequence.size, finished["written"]):
        return len(sequence), None, finished["summary"]
    if done > 0 or finished:  # else whatever is there is of a run that did not come as far as its second frame
        needed = done and done + options.lookahead  # frames that the finished ones have been made from
        refuse_other(out, metadata, options, fingerprints[needed] if needed <= len(sequence) else "")
    known = done > 0 and len(summary.exposure) == done
    if not known or not are_finished(out, names[:done], sequence.size, metadata["written"]):
        return 0, None, Summary()
    return done, history, summary
