"""The best picture for frames on disk: `rtdenoise denoise SEQ --out DIR --offline`.

Two passes over the sequence. The first one runs forward in time and leaves its estimates in a hidden folder inside DIR.
The second one runs backward, from the last frame to the first; it combines both estimates of each frame (`passes`).
Once the one before it is combined as well, a frame takes some of the pictures on either side and is written, and what
was stored of it is removed. Four frames and a history are in memory at a time. An interrupted run goes on where it
stopped, in either pass, to the same result: what other frames need is always read back from disk.

A shot begins at the first frame, after a gap, and at a cut, which the first pass finds. No pass looks beyond its shot.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..data.output import write_frame
from ..data.output_files import check_output, output_names
from ..data.sequences import Sequence
from ..errors import InputError
from ..files import lock, remove_unfinished
from ..frame import MAX_CUT_MISMATCH, Frame, reverse
from ..models.weights import bytes_beside, files_of, find
from ..sanitise import faults
from .choice import open_chosen, told_of_samples
from .combined import Beside, Combined, read_combined, write_combined
from .folder import (
    Written,
    are_finished,
    clear,
    conclude,
    digest,
    digest_of,
    prepare,
    refuse_foreign,
    refuse_no_folder,
    refuse_other,
)
from .following import Following
from .options import EXAMINED, Options, of_output
from .stand_ins import told_of_missing, with_stand_ins
from .state import STATE, last_of_shot, linked, read_state, save_state
from .stored_estimate import BYTES_PER_PIXEL, check_disk, read_estimate, write_estimate
from .summary import Summary, add
from .unmoved import Watch

if TYPE_CHECKING:
    from .passes import Passes

ESTIMATES = ".rtdenoise-forward"  # folder in the output folder: the first pass's estimates, removed at the end
OF_ESTIMATE = re.compile(r"\d{6,}(-combined)?\.safetensors")  # names in it


def denoise_offline(
    source: str,
    out: str | Path,
    options: Options,
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """As `denoise.denoise`, for options with `offline`. `on_frame(done, total)` counts the frames of both passes: total
    is twice the number of frames.

    Frames appear in the output folder from the last one to the first. Appended frames change what the frames before
    them look like, so a finished run is not continued: `overwrite` starts anew.
    """
    if find_spec("torch") is None:
        raise InputError("--offline needs PyTorch, which is not installed; leave it out")
    sequence, options, notes = open_chosen(source, options)
    if len(sequence) > 1:
        sequence.require("motion")  # without it no other frame counts
    notes += told_of_samples(sequence, options.samples) + told_of_missing(sequence, False, source)
    check_output(sequence, options.layout, options.recombine, options.keep, options.alpha, options.confidence)
    from .passes import Passes

    passes = Passes(options.model, options.device, options.precision)
    out = prepare(Path(out), sequence, options)
    with lock(out):
        remove_unfinished(out)
        summary = _Run(sequence, out, options, passes, on_frame).run(overwrite)
        conclude(out, sequence, options, notes + _notes(sequence, passes), summary)
    return summary


@dataclass
class _Run:
    """One run over one sequence. `done` counts the frames of both passes."""

    sequence: Sequence
    out: Path
    options: Options
    passes: Passes
    on_frame: Callable[[int, int], None]

    def run(self, overwrite: bool) -> Summary:
        from .pixel_filter import MODEL

        # It follows forward; backward frames are divided by the same gains.
        self.backend = Following(self.passes.backend, self.options.detect_exposure)
        # Frames with and without OIDN must not be mixed, nor estimates that are stored otherwise.
        files = files_of(find(MODEL))
        files += bytes_beside(files)
        opinions = "with OIDN" if self.passes.has_oidn else f"without OIDN, by {digest_of(files)}"
        self.fingerprint = f"{digest(self.sequence, self.options)[-1]} {opinions}, {BYTES_PER_PIXEL} bytes"
        self.names = output_names(self.sequence, self.options.layout, self.options.recombine)[::-1]  # as they appear
        count = len(self.sequence)
        done, history, summary = (0, None, Summary()) if overwrite else self._resume()
        self.summary, self.written = summary, Written(self.out, self.names[: self._written(done)])
        summary.skipped, summary.gaps = self._written(done), list(self.sequence.gaps)
        summary.ran, self.watch = self.backend.ran, Watch(summary.notes)
        refuse_no_folder(self.estimates)
        if not done:
            clear(self.estimates, OF_ESTIMATE.fullmatch)
            self._save(0, None)
        if done < 2 * count:
            check_disk(self.out, count - min(done, count), self.sequence.read_size)
            self.estimates.mkdir(exist_ok=True)
            remove_unfinished(self.estimates)
        if self.options.plan:  # tiles for large frames
            self.backend.plan(self.sequence.read_size, count, self._examined(), {})

        if history is not None:
            history = self.backend.remember(history, self._recent(done))
        self.on_frame(done, 2 * count)
        for step in range(done, 2 * count):
            started = time.perf_counter()
            if step < count:
                history = self._forward(step, history)
            else:
                i = 2 * count - 1 - step
                history = self._backward(i, history if step > count else None)
                for k in range(self._written(step), self._written(step + 1)):
                    self._finish(count - 1 - k)
                    self.written.add(self.names[k])
                    summary.written += 1
            summary.seconds += time.perf_counter() - started
            if step + 1 == count:
                self.watch.end(count, len(summary.cuts))
            self._save(step + 1, history)
            if step >= count:
                for path in (self._path(i), self._combined(i + 2)):
                    path.unlink(missing_ok=True)
            self.on_frame(step + 1, 2 * count)
        clear(self.estimates, OF_ESTIMATE.fullmatch)
        return summary

    def _forward(self, i: int, history: Any) -> Any:
        """Estimate frame i from the frames before; store the estimate."""
        backend, frame = self.backend, self.sequence.read(i)
        add(self.summary.replaced, faults(frame))
        prepared = backend.prepare(with_stand_ins(frame))
        if i and frame.number != self.sequence.numbers[i - 1] + 1:
            history = None
        cut = self.options.detect_cuts and history is not None
        if cut and backend.mismatch(prepared, history) > MAX_CUT_MISMATCH:
            self.summary.cuts.append(frame.number)
            history = None
        self.watch.see(frame, history is not None)
        given = backend.enter(prepared, history, ())
        estimate, after = self.passes.step(given.frame, given.history)
        write_estimate(self._path(i), estimate)
        history = given.left(after)
        self.summary.exposure[i:] = [backend.gain(history)]
        return history

    def _backward(self, i: int, history: Any) -> Any:
        """Estimate frame i from the frames after, combine, and store what came of it."""
        if history is not None and not self._linked(i + 1):
            history = None
        frame = self._completed(i)
        backward, history = self.passes.step(reverse(frame), history)
        forward = read_estimate(self._path(i), self.passes.backend.device, self.sequence.read_size)
        write_combined(self._combined(i), self.passes.combine(frame, forward, backward))
        return history

    def _finish(self, i: int) -> None:
        """Write frame i, with the pictures of the frames beside it in its shot."""
        raw, frame, gain = self.sequence.read(i), self._completed(i), self.summary.exposure[i]
        own = self._read_combined(i)
        before, after = (self._beside(i, k) for k in (i - 1, i + 1))
        image = self.passes.settle(frame, own, before, after).cpu().numpy() * gain
        extra = {"confidence": own.spread.cpu().numpy() * gain} if self.options.confidence else {}
        nans = write_frame(self.out, self.sequence, i, raw, image, **of_output(self.options), extra=extra)
        add(self.summary.passed_on, nans)

    def _beside(self, i: int, k: int) -> Beside | None:
        """Frame k beside frame i; None where there is none in its shot."""
        if not 0 <= k < len(self.sequence) or not self._linked(max(i, k)):
            return None
        return Beside(self._prepared(k), self._read_combined(k).image)

    def _read_combined(self, i: int) -> Combined:
        return read_combined(self._combined(i), self.passes.backend.device, self.sequence.read_size)

    def _recent(self, done: int) -> list[Frame]:
        """The last frames of the shot that the pass at work has finished, as it saw them, the newest first."""
        count, most = len(self.sequence), self.backend.config.recent + 1
        if done < count:
            return [self._prepared(i) for i in last_of_shot(self.sequence, done, self.summary.cuts, most)]
        first = end = 2 * count - done
        while end < min(first + most, count) and (end == first or self._linked(end)):
            end += 1
        return [reverse(self._completed(i)) for i in range(first, end)]

    def _prepared(self, i: int) -> Frame:
        return self.backend.prepare(with_stand_ins(self.sequence.read(i)))

    def _completed(self, i: int) -> Frame:
        """Frame i, prepared, and divided as in the first pass; where the files lack `motion_next`, with that of the
        next frame of the shot."""
        from ..splat import completed

        frame = self._prepared(i).divided(self.summary.exposure[i])
        if frame.motion_next is not None or i + 1 == len(self.sequence) or not self._linked(i + 1):
            return frame
        return completed(frame, self._prepared(i + 1))

    def _linked(self, i: int) -> bool:
        """Whether frame i goes on with the shot of the frame before."""
        return linked(self.sequence, i, self.summary.cuts)

    def _examined(self) -> list[Frame]:
        return [self.sequence.read(i) for i in range(min(EXAMINED, len(self.sequence)))]

    @property
    def estimates(self) -> Path:
        return self.out / ESTIMATES

    def _path(self, i: int) -> Path:
        return self.estimates / f"{i:06d}.safetensors"

    def _combined(self, i: int) -> Path:
        return self.estimates / f"{i:06d}-combined.safetensors"

    def _written(self, done: int) -> int:
        """How many frames are written after so many steps: each once that before it is combined."""
        count = len(self.sequence)
        return count if done == 2 * count else max(0, done - count - 1)

    def _resume(self) -> tuple[int, Any, Summary]:
        """How far an earlier run came: frames done in both passes, the history, and the summary so far."""
        path = self.out / STATE
        if not path.exists():
            refuse_foreign(self.out, self.names)
            return 0, None, Summary()
        done, history, summary, state = read_state(path, self.backend)
        if done <= 0:
            return 0, None, Summary()
        refuse_other(self.out, state, self.options, self.fingerprint)
        count = len(self.sequence)
        waiting = range(done) if done < count else range(2 * count - done)
        finished = self.names[: self._written(done)]
        complete = are_finished(self.out, finished, self.sequence.size, state["written"])
        known = complete and len(summary.exposure) == min(done, count)
        stored = [self._path(i) for i in waiting]
        if count < done < 2 * count:
            stored += [self._combined(i) for i in range(len(waiting), min(len(waiting) + 2, count))]
        if not known or not all(path.exists() for path in stored):
            return 0, None, Summary()
        return done, history, summary

    def _save(self, done: int, history: Any) -> None:
        fields = {} if history is None or done == 2 * len(self.sequence) else self.backend.save(history)
        save_state(
            self.out / STATE, fields, done, self.fingerprint, self.summary, self.options, self.written.digest
        )  # fmt: skip


def _notes(sequence: Sequence, passes: Passes) -> list[str]:
    """What the user should know of the passes."""
    if len(sequence) == 1 or sequence.has("motion_next"):
        return list(passes.notes)
    return [*passes.notes, "the files have no motion_next: the backward pass approximates it from motion and depth"]
