"""The loop of `rtdenoise combine`: a stream of frames with their estimates, windows of it, corrected frames on disk."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from ..data.output import write_frame
from ..data.output_files import output_names
from ..data.sequences import Sequence
from ..frame import MAX_CUT_MISMATCH, Frame, geometry
from ..history import mismatch
from ..models import Combiner, Shrinkage, Window
from ..sanitise import faults
from ..splat import completed
from .folder import Written, are_finished, digest, refuse_foreign, refuse_other
from .memory import explained
from .options import CombineOptions, of_output
from .pairs import both, read_alpha, read_estimate
from .shadows import find_shadows
from .state import STATE, read_state, save_state
from .summary import Summary, add
from .windows import windows


@dataclass(frozen=True)
class Pair:
    """A frame of the stream."""

    index: int
    raw: Frame  # numpy, as it was read
    frame: Frame  # tensors on the device; motion and motion_next only within the shot
    estimate: Tensor  # [1, 3, H, W] the denoised frame
    half: Tensor | None  # [1, 3, H, W] the noisy frame of the first render, where there are two


@dataclass
class Run:
    """One run over one pair of sequences."""

    source: Sequence
    estimates: Sequence
    second: Sequence | None
    out: Path
    options: CombineOptions
    combiner: Combiner | Shrinkage
    device: str
    on_frame: Callable[[int, int], None]

    def run(self, overwrite: bool, notes: list[str]) -> Summary:
        """Correct and write the frames that are not there yet."""
        count, reach = len(self.source), max(abs(offset) for offset in self.combiner.offsets)
        self.fingerprints = self._fingerprints()
        self.names = output_names(self.source, self.options.layout, self.options.recombine)
        self.counted = 0  # frames whose faults an earlier run has counted
        done, self.summary = (0, Summary()) if overwrite else self._resume(reach)
        self.written = Written(self.out, self.names[:done])
        self.summary.skipped, self.summary.gaps = done, list(self.source.gaps)
        self.summary.notes = notes
        self.shadows = find_shadows(self.source, self.options)  # which the denoised frames may have without noise
        if not done or done < self.counted:  # a frame that is written anew is another file than its state knows
            self._save(done)
        self.on_frame(done, count)
        started = time.perf_counter()
        if done < count:
            for window in windows(self._pairs(max(0, done - reach)), reach):
                pair = window[reach]
                if pair.index < done:
                    continue
                self._write(pair, window)
                self.written.add(self.names[pair.index])
                self.summary.seconds += time.perf_counter() - started
                self._save(pair.index + 1)
                self.summary.written += 1
                self.on_frame(pair.index + 1, count)
                started = time.perf_counter()
        return self.summary

    def _write(self, pair: Pair, window: tuple[Pair | None, ...]) -> None:
        """Correct the frame in the middle of a window and write it."""
        chosen = [window[len(window) // 2 + offset] for offset in self.combiner.offsets]
        frames, estimates, halves = zip(*((p and p.frame, p and p.estimate, p and p.half) for p in chosen), strict=True)
        with torch.inference_mode(), explained(pair.raw.name, pair.raw.size, self.device):
            combined = self.combiner.combine(Window(frames, estimates, halves if self.second else ()))
        extra = {"confidence": combined.confidence.cpu().numpy()} if self.options.confidence else {}
        image = combined.image.cpu().numpy()
        nans = write_frame(self.out, self.source, pair.index, pair.raw, image, **of_output(self.options), extra=extra,
                           coverage=read_alpha(self.estimates, pair.index) if self.shadows else None)  # fmt: skip
        if pair.index >= self.counted:
            lost = int((~pair.estimate.isfinite()).any(1).sum())
            add(self.summary.replaced, faults(pair.raw) | ({"denoised: NaN or Inf": lost} if lost else {}))
            add(self.summary.passed_on, nans)

    def _pairs(self, first: int) -> Iterator[tuple[Pair, bool]]:
        """The frames from `first` on, and whether a shot begins with each. A frame without `motion_next` gets an
        approximate one from the next frame of its shot, so it is handed on when that is known."""
        before, began = None, True
        for i in range(first, len(self.source)):
            pair = self._read(i)
            begins = before is None or self._begins(pair, before)
            if before is not None:
                yield (before if begins else _linked(before, pair)), began
            before, began = pair, begins
        if before is not None:
            yield before, began

    def _read(self, i: int) -> Pair:
        raw = self.source.read(i)
        counted = raw.with_samples(self.options.samples or self.source.header.samples)
        frame, half = counted.map(torch.from_numpy).to(self.device), None
        if self.second:
            frame, half = both(frame, read_estimate(self.second, i).to(self.device))
        return Pair(i, raw, frame, read_estimate(self.estimates, i).to(self.device), half)

    def _begins(self, pair: Pair, before: Pair) -> bool:
        """Whether a shot begins with a frame: after a gap, at a cut, and everywhere without motion."""
        frame, last = pair.frame, before.frame
        if frame.motion is None or frame.number != last.number + 1:
            return True
        if not self.options.detect_cuts:
            return False
        cut = mismatch(frame, geometry(last)).item() > MAX_CUT_MISMATCH
        if cut and frame.number not in self.summary.cuts:
            self.summary.cuts.append(frame.number)
        return cut

    def _fingerprints(self) -> list[str]:
        """`folder.digest` of all sequences."""
        inputs = [self.source, self.estimates, *([self.second] if self.second else [])]
        digests = zip(*(digest(one, self.options) for one in inputs), strict=True)
        return [hashlib.sha256("".join(parts).encode()).hexdigest() for parts in digests]

    def _resume(self, reach: int) -> tuple[int, Summary]:
        """How many frames are finished and will stay as they are, and the summary so far."""
        path = self.out / STATE
        if not path.exists():
            refuse_foreign(self.out, self.names)
            return 0, Summary()
        done, _, summary, state = read_state(path)
        if done <= 0:
            return 0, Summary()
        seen = next((k for k, mark in enumerate(self.fingerprints) if mark == state["fingerprint"]), None)
        refuse_other(self.out, state, self.options, "" if seen is None else self.fingerprints[seen])
        if not are_finished(self.out, self.names[:done], self.source.size, state["written"]):
            return 0, Summary()
        self.counted = state["counted"]
        if seen < len(self.source):  # the last frames could not look ahead then
            done = min(done, max(0, seen - reach))
        return done, summary

    def _save(self, done: int) -> None:
        save_state(
            self.out / STATE, {}, done, self.fingerprints[-1], self.summary, self.options, self.written.digest,
            self.counted,
        )  # fmt: skip


def _linked(pair: Pair, following: Pair) -> Pair:
    return pair if pair.frame.depth is None else replace(pair, frame=completed(pair.frame, following.frame))
