"""Motion vectors with the motion of the lens: `--lens` adds the zoom or shift that `lens.find_drift` finds. For frames
of Cycles, whose vectors may lack it, some pairs tell whether it is needed. Needs no torch, but to find it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, TypeVar

from ..data.sequences import Sequence
from ..errors import InputError
from ..frame import Frame
from .options import CombineOptions, Options

if TYPE_CHECKING:
    from .lens import Drift

Chosen = TypeVar("Chosen", Options, CombineOptions)

FIRST, STEP = 4, 16  # of the frames that are compared with the one before: a zoom may begin slowly, or late
FOUND = (
    "the picture zooms or shifts against its motion vectors: --lens, which adds that, is on (--no-detect-lens: as they "
    "are)"
)


def with_lens_if_lacking(sequence: Sequence, options: Chosen) -> tuple[Sequence, Chosen, list[str]]:
    """The sequence with the motion of its lens and the options with `lens`, where they have that or where it is found
    to be lacking, which is told. Raises InputError as `with_lens`, and for `options.lens` without torch."""
    has_torch = find_spec("torch") is not None
    if options.lens and not has_torch:
        raise InputError("--lens needs PyTorch, which is not installed; leave it out")
    found = not options.lens and options.detect_lens and has_torch and lacks_lens(sequence)
    if not (options.lens or found):
        return sequence, options, []
    return with_lens(sequence), replace(options, lens=True), [FOUND] if found else []


def lacks_lens(sequence: Sequence) -> bool:
    """Whether frames are of Cycles, and the vectors of one in STEP of them lack a motion of the lens. A frame that
    cannot be read says nothing: the run tells of it."""
    if sequence.layout.name != "cycles" or not (sequence.has("motion") and sequence.has("albedo")):
        return False
    hints, drifts, last = Drifts(sequence, known=True), Drifts(sequence), len(sequence) - 1
    for i in range(min(FIRST, last), last + 1, STEP):
        with suppress(InputError):
            # What a pair hints at, one beside it may show: in a pair of its own much may be uncovered, or hardly move.
            if hints.of(i) and any(drifts.of(j) for j in (i, i - 1, i + 1) if 0 < j <= last):
                return True
    return False


class Drifts:
    """What the vectors of each frame lack, found when it is asked for."""

    def __init__(self, sequence: Sequence, known: bool = False) -> None:
        """Of a sequence with albedo and motion. `known`: as of `lens.find_drift`."""
        self._sequence = sequence.only({"radiance", "albedo", "motion"})
        self._known = known
        self._found: dict[int, Drift | None] = {}
        self._frames: dict[int, Frame] = {}  # the last two that were read

    def of(self, i: int) -> Drift | None:
        """That of frame i; None where nothing is lacking, and where the frame before is missing."""
        from .lens import find_drift

        if i not in self._found:
            pair = (self._frame(i - 1), self._frame(i)) if self._follows(i) else None
            self._found[i] = find_drift(*pair, self._known) if pair else None
        return self._found[i]

    @property
    def told(self) -> str:
        """Of how many frames the vectors lacked something, among those asked for: a run that goes on asks for some. A
        frame that seems to lack nothing amid such is named."""
        lacking, read = sum(drift is not None for drift in self._found.values()), len(self._found)
        some = "" if read == len(self._sequence) else " that this run read"
        lone = [self._sequence.numbers[i] for i, drift in sorted(self._found.items()) if not drift and self._between(i)]
        but = f", but found nothing for {', '.join(map(str, lone))} between them" if lone else ""
        return f"--lens: added what the vectors of {lacking} of {read} frames{some} lack{but}"

    def _follows(self, i: int) -> bool:
        """Whether the frame before is there."""
        numbers = self._sequence.numbers
        return i > 0 and numbers[i] == numbers[i - 1] + 1

    def _between(self, i: int) -> bool:
        """Whether vectors lack something within two frames before and after, and the frame before is there."""
        return self._follows(i) and all(any(self._found.get(i + side * k) for k in (1, 2)) for side in (-1, 1))

    def _frame(self, i: int) -> Frame:
        if i not in self._frames:
            self._frames = dict([*self._frames.items()][-1:]) | {i: self._sequence[i]}
        return self._frames[i]


@dataclass(frozen=True)
class WithLens(Sequence):
    """A sequence whose `motion` has the motion of the lens. Its frames have no `motion_next`: it would take the frame
    after, and is approximated as where files lack it."""

    drifts: Drifts | None = field(default=None, repr=False, compare=False)

    def read(self, i: int) -> Frame:
        """As `Sequence.read`."""
        frame = super().read(i)
        drift = None if frame.motion is None else self.drifts.of(i)
        motion = drift.added_to(frame.motion) if drift else frame.motion
        return replace(frame, motion=motion, motion_next=None)


def with_lens(sequence: Sequence) -> WithLens:
    """Raises InputError where the sequence has no motion, or no albedo to compare."""
    sequence.require("motion", "albedo")
    parts = {part.name: getattr(sequence, part.name) for part in fields(sequence)}
    for layers in ("rules", "available"):
        parts[layers] = {layer: rule for layer, rule in parts[layers].items() if layer != "motion_next"}
    if sequence.surfaces:
        parts["surfaces"] = sequence.surfaces.only({*sequence.surfaces.layers} - {"motion_next"})
    return WithLens(**parts, drifts=Drifts(sequence, known=True))
