"""Steps recorded as CUDA graphs and replayed: on a GPU a step is some hundreds of kernels, and launching them one by
one from Python can take longer than running them.

A recording always reads and writes the memory of the recorded step. So `Graphed` copies the arguments there, replays
the recording, and copies the results out: tensors in a caller's hands are never overwritten. Kept frames, most of what
goes in, stay where they are: kernels that can load addresses from memory get those instead (`ops.elsewhere`).

A recording serves one *kind* of step: the layers, their sizes and dtypes, whether there is a history, and the flags of
`Known`. Everything else that a step depends on (weights, `ops.use`) stays as it was at the recording.

Read `Graphed.step` first. docs/reference/backends.md says which steps can be recorded.
"""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable, Collection, Hashable
from dataclasses import replace
from typing import Protocol, TypeVar

import torch
from torch import Tensor, nn

from ..errors import InputError
from ..frame import NOTHING_KNOWN, RECENT, Frame, History, Known
from ..history import Step
from ..ops.elsewhere import Elsewhere, NotHere, fill, table
from .plan import LAYERS

MAX_RECORDINGS = 8  # a sequence has two to five kinds of steps
UNREAD = "footprint", "trusted"  # fields of a history that no step reads begin so
IDLE_STEPS = 64  # a recording unused for so many steps makes room; a kind of step seen once is forgotten after as many
WARM_UP_STEPS = 3  # before a step is captured, as in PyTorch's documentation
LARGEST = 6_000_000  # pixels of a step that is recorded: kernels of larger ones take longer than to start them

Written = TypeVar("Written")


class Recorder(Protocol):
    """Records the work of a function on tensors."""

    def __call__(self, function: Callable[[], Written]) -> tuple[Callable[[], object], Written]:
        """Return a replay callable and the output of `function`; its tensors are valid after each replay, until another
        recording of this recorder is replayed. Raises RuntimeError where the function cannot be recorded."""


class Capture:
    """Records CUDA graphs as PyTorch's notes on CUDA semantics say: warmed up on a side stream, captured by
    `torch.cuda.graph`. They share one pool of memory, which those notes allow because no graph needs the results of
    another and no two run at once. During a capture nothing else in the process may use the GPU."""

    def __init__(self, device: torch.device) -> None:
        self._device, self._pool = device, None

    def __call__(self, function: Callable[[], Written]) -> tuple[Callable[[], object], Written]:
        # The second context restores the current stream: a failed capture would leave its own current.
        with torch.cuda.device(self._device), torch.cuda.stream(torch.cuda.current_stream(self._device)):
            self._pool = self._pool or torch.cuda.graph_pool_handle()
            side = torch.cuda.Stream()
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                for _ in range(WARM_UP_STEPS):
                    function()
            torch.cuda.current_stream().wait_stream(side)
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph, pool=self._pool):
                written = function()
        return graph.replay, written


def stepper(denoiser: nn.Module) -> Step:
    """The denoiser's `step`: on CUDA recorded (`Graphed`), unless the environment has RTDENOISE_GRAPHS=off. Raises
    InputError for another value of that."""
    choice = os.environ.get("RTDENOISE_GRAPHS", "auto")
    if choice not in ("auto", "off"):
        raise InputError(f"RTDENOISE_GRAPHS: expected auto or off, got {choice!r}")
    device = next(denoiser.parameters()).device
    return Graphed(denoiser, Capture(device)).step if device.type == "cuda" and choice == "auto" else denoiser.step


class Graphed:
    """A denoiser that records each kind of step, of up to LARGEST pixels, at its second occurrence and replays it from
    then on. `step` is as the denoiser's, without gradients. If a step cannot be recorded, one warning is logged and all
    steps run unrecorded."""

    def __init__(self, denoiser: nn.Module, record: Recorder) -> None:
        self.denoiser = denoiser
        self.recordings: dict[Hashable, RecordedStep] = {}  # by kind
        self._record: Recorder | None = record
        self._seen: deque[Hashable] = deque(maxlen=IDLE_STEPS)  # kinds of the last steps that were not replayed
        self._steps = 0

    @torch.no_grad()
    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """As the denoiser's own step."""
        if frame.radiance.numel() > 3 * LARGEST:
            return self.denoiser.step(frame, history, known)
        self._steps += 1
        given = _tensors(frame, history, known, (*LAYERS, *self.denoiser.config.reads))
        flags = replace(known, exposure=None, distance=None, noise=None, shift=None, ahead=(), turning=(), coming=())
        kind = (flags, frame.more_history), tuple(_description(name, tensor) for name, tensor in given.items())
        if kind not in self.recordings and kind in self._seen and self._room():
            self._add(kind, given)
        if kind in self.recordings:
            self.recordings[kind].used = self._steps
            return self.recordings[kind].play(given)
        result = self.denoiser.step(frame, history, known)
        self._seen.append(kind)
        return result

    def _add(self, kind: Hashable, given: dict[str, Tensor]) -> None:
        read = {_description(n, t): t for recording in self.recordings.values() for n, t in recording.read.items()}
        try:
            self.recordings[kind] = RecordedStep(self.denoiser, kind[0], given, read, self._record)
        except RuntimeError as error:  # not permitted in a capture, or out of memory
            self.recordings.clear()
            self._record = None
            why = str(error).partition("\n")[0]
            logging.getLogger("rtdenoise").warning("rtdenoise: slower without CUDA graphs: %s", why)

    def _room(self) -> bool:
        """Whether one more step may be recorded. The least recently used recording makes room if it is idle."""
        if self._record is None:
            return False
        if len(self.recordings) < MAX_RECORDINGS:
            return True
        kind = min(self.recordings, key=lambda kind: self.recordings[kind].used)
        idle = self._steps - self.recordings[kind].used > IDLE_STEPS
        if idle:
            del self.recordings[kind]
        return idle


class RecordedStep:
    """One recorded step, replayed with tensors like those `given`. It shares the input memory `read` of other
    recordings where name, shape and dtype agree: inputs are copied in before each replay. Kept frames are not, unless
    something reads them that needs them here."""

    def __init__(
        self,
        denoiser: nn.Module,
        flags: tuple[Known, bool],  # and `Frame.more_history`
        given: dict[str, Tensor],
        read: dict[Hashable, Tensor],
        record: Recorder,
    ) -> None:
        self.used = 0  # number of the last step that replayed it
        kept = {name: tensor for name, tensor in given.items() if name.startswith(f"history.{RECENT}")}
        # Tensors created in inference mode could not be written outside it.
        with torch.inference_mode(False), torch.no_grad():
            self.read = _memory({name: tensor for name, tensor in given.items() if name not in kept}, read)
            self._addresses = table(len(kept), given["frame.radiance"].device)
            self.elsewhere = {n: Elsewhere(t, self._addresses[i, :1]) for i, (n, t) in enumerate(kept.items())}
            try:
                self._record(denoiser, flags, given, record)
            except NotHere:
                self.elsewhere = {}
                self.read |= _memory(kept, read)
                self._record(denoiser, flags, given, record)

    def _record(
        self, denoiser: nn.Module, flags: tuple[Known, bool], given: dict[str, Tensor], record: Recorder
    ) -> None:
        held = self._point_to(given)  # what is recorded runs before
        arguments = _arguments(self.read | self.elsewhere, *flags)
        self._replay, self._written = record(lambda: denoiser.step(*arguments))
        del held

    def _point_to(self, given: dict[str, Tensor]) -> list[Tensor]:
        """Let the recording find the kept frames among `given`. The tensors to hold until it has been replayed."""
        frames = [given[name].contiguous() for name in self.elsewhere]
        if frames:
            fill(self._addresses, frames)
        return frames

    def play(self, given: dict[str, Tensor]) -> tuple[Tensor, History]:
        """Replay the step on the tensors `given`. Tensors that the step only passes on are returned as given, results
        as copies."""
        _copy(list(self.read.values()), [given[name] for name in self.read])
        held = self._point_to(given)
        self._replay()
        del held  # whatever is written there from now on, by its owner too, comes later on the stream
        out = {id(tensor): given[name] for name, tensor in (self.read | self.elsewhere).items()}
        image, history = self._written
        written = {id(tensor): tensor for tensor in (image, *history.layers().values()) if id(tensor) not in out}
        copies = [torch.empty_like(tensor) for tensor in written.values()]
        _copy(copies, list(written.values()))
        out |= zip(written, copies, strict=True)
        return out[id(image)], History.from_layers({n: out[id(t)] for n, t in history.layers().items()})


def _memory(given: dict[str, Tensor], read: dict[Hashable, Tensor]) -> dict[str, Tensor]:
    """Where to copy the tensors `given`: that of `read` where there is such, or else their first copies."""
    described = {name: read.get(_description(name, tensor)) for name, tensor in given.items()}
    return {n: given[n].clone(memory_format=torch.contiguous_format) if t is None else t for n, t in described.items()}


def _copy(targets: list[Tensor], sources: list[Tensor]) -> None:
    """All tensors of a dtype in a launch or two; torch copies lists of several dtypes one by one."""
    pairs = list(zip(targets, sources, strict=True))
    for dtype in {tensor.dtype for tensor in targets}:
        alike = [pair for pair in pairs if pair[0].dtype == dtype]
        torch._foreach_copy_(*(list(tensors) for tensors in zip(*alike, strict=True)))


def _description(name: str, tensor: Tensor) -> Hashable:
    return name, tensor.shape, tensor.dtype, tensor.device


def _tensors(frame: Frame, history: History | None, known: Known, read: Collection[str]) -> dict[str, Tensor]:
    """All that a step reads, by name; of the frame the layers `read`, of the history all but `UNREAD`. Inverse:
    `_arguments`."""
    statistics = {n: t for n in ("exposure", "distance", "noise", "shift") if (t := getattr(known, n)) is not None}
    layers = {n: t for n, t in frame.layers() if n in read}
    past = {n: t for n, t in history.layers().items() if not n.startswith(UNREAD)} if history else {}
    owners = {"frame": layers, "history": past, "known": statistics}
    for i, other in enumerate(known.ahead):
        owners[f"ahead{i}"] = {n: t for n, t in other.layers() if n in read}
    return {f"{owner}.{name}": tensor for owner, tensors in owners.items() for name, tensor in tensors.items()}


def _arguments(
    tensors: dict[str, Tensor], known: Known, more_history: bool
) -> tuple[Frame, History | None, Known]:
    """The arguments of a step that reads these tensors, with these flags."""

    def of(owner: str) -> dict[str, Tensor]:
        return {n.removeprefix(owner): t for n, t in tensors.items() if n.startswith(owner)}

    past, count = of("history."), len({name.partition(".")[0] for name in tensors if name.startswith("ahead")})
    known = replace(known, **of("known."), ahead=tuple(Frame(**of(f"ahead{i}.")) for i in range(count)))
    return Frame(**of("frame."), more_history=more_history), History.from_layers(past) if past else None, known
