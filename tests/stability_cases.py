"""Promises of the denoiser for extreme and broken input: one table of cases, for the tests and bench/stability.py.

A case plays frames through a `Subject` (a denoiser at some precision, or in training) and returns what was measured, to
be compared with what is promised. In all cases the outputs, histories and losses of steps must be finite: the subject
counts other values.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from synthetic import make_frames
from torch import Tensor

from rtdenoise.errors import InputError
from rtdenoise.exposure import exposure, limit_fireflies
from rtdenoise.frame import OFF_SCREEN, Frame, History
from rtdenoise.models import load, read
from rtdenoise.models.hybrid_config import HybridConfig
from rtdenoise.models.losses import temporal_kpn_loss
from rtdenoise.models.weights import find, has_bytes, read_config
from rtdenoise.sanitise import GREATEST_ALBEDO

PRECISIONS = {"float32": "fp32", "bfloat16": "bf16", "int8": "int8"}  # of a loaded model
AUTOCAST = {"float16": torch.float16, "training": torch.bfloat16}  # of one as it was trained
MODES = (*PRECISIONS, *AUTOCAST)
FIREFLY = 1e7
AT = (12, 15)  # the pixel that is broken: row, column


class Subject:
    """A denoiser whose steps are watched. Mode "training" also takes the loss and its gradients, in bfloat16 as
    training does. `of` gives the denoiser that goes with a mode. It remembers what it has seen: cases share many runs
    and beginnings of runs, of which each is played once."""

    def __init__(self, denoiser: torch.nn.Module, mode: str = "float32", frames: int = 100) -> None:
        self.denoiser, self.mode = denoiser, mode
        self.parameters = list(denoiser.parameters())  # once: to find them takes up to a tenth of a step
        self.frames = 6 if mode == "training" else frames  # of the cases that take long sequences
        self.non_finite = 0  # values so far, over outputs, histories, losses and gradients
        self.played: dict[bytes, tuple[Tensor, int]] = {}  # frames from a first one on -> image and non-finite values
        self.left: dict[bytes, History] = {}  # frames of whole runs -> the history after them

    @classmethod
    def of(cls, model: str, mode: str, frames: int = 100) -> Subject:
        """A shipped model in one of its modes (`modes_of`)."""
        precision = PRECISIONS.get(mode)
        return cls(load(model, precision=precision) if precision else read(model), mode, frames)

    def step(self, frame: Frame, history: History | None = None) -> tuple[Tensor, History]:
        training, dtype = self.mode == "training", AUTOCAST.get(self.mode)
        with torch.autocast("cpu", dtype, enabled=dtype is not None), _gradients(self.parameters, training):
            image, history = self.denoiser.step(frame, history)
            if training:
                reference = torch.full_like(image, 0.5)
                weights = torch.full_like(image[:, :1], 1.8)
                terms = temporal_kpn_loss(image, reference, (image.detach(), reference), weights, exposure(reference))
                loss = terms.total.mean()
                parameters = [p for p in self.parameters if p.requires_grad]
                gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
                self.count(loss, *(g for g in gradients if g is not None))
        tensors = {name: tensor.detach() for name, tensor in history.layers().items()}
        self.count(image, *tensors.values())
        return image.detach(), History.from_layers(tensors)

    def play(self, frames: list[Frame]) -> list[Tensor]:
        """The outputs of consecutive frames, without a history before the first."""
        keys = _keys(frames)
        if any(key not in self.played for key in keys):
            known = max((i for i, key in enumerate(keys, start=1) if key in self.left), default=0)
            history = self.left[keys[known - 1]] if known else None
            before = self.non_finite
            for key, frame in zip(keys[known:], frames[known:], strict=True):
                self.non_finite = 0
                image, history = self.step(frame, history)
                self.played[key] = image, self.non_finite
            self.left[keys[-1]], self.non_finite = history, before
        self.non_finite += sum(self.played[key][1] for key in keys)
        return [self.played[key][0] for key in keys]

    def count(self, *tensors: Tensor) -> None:
        self.non_finite += sum(int((~tensor.isfinite()).sum()) for tensor in tensors)


def _keys(frames: list[Frame]) -> list[bytes]:
    """What tells runs apart, after each frame."""
    keys, run = [], hashlib.sha256()
    for frame in frames:
        run.update(repr([(name, tensor.dtype, tensor.shape) for name, tensor in frame.layers()]).encode())
        run.update(repr((frame.number, frame.name)).encode())
        for _, tensor in frame.layers():
            run.update(tensor.contiguous().numpy().tobytes())
        keys.append(run.digest())
    return keys


def modes_of(model: str) -> tuple[str, ...]:
    """Int8 is for models that have weights in bytes, float16 for kernels alone: with torch it is no precision of ours,
    and most CPUs take ten times as long in it for a network that writes pixels."""
    path, pixels = find(model), isinstance(read_config(model), HybridConfig)
    return tuple(m for m in MODES if not (m == "int8" and not has_bytes(path)) and not (m == "float16" and pixels))


@contextlib.contextmanager
def _gradients(parameters: list[torch.nn.Parameter], wanted: bool) -> Iterator[None]:
    before = [p.requires_grad for p in parameters]
    try:
        with torch.set_grad_enabled(wanted):
            for parameter in parameters:
                parameter.requires_grad_(wanted)
            yield
    finally:
        for parameter, flag in zip(parameters, before, strict=True):
            parameter.requires_grad_(flag)


@dataclass(frozen=True)
class Case:
    """One promise. `measure` returns the number that must be at most `bound`, or `half` in reduced precision, or
    `whole` in bytes."""

    name: str
    promise: str
    unit: str
    bound: float
    measure: Callable[[Subject], float]
    half: float | None = None  # None: as `bound`
    whole: float | None = None  # None: as `half`

    def limit(self, mode: str) -> float:
        """The bound in a mode; in training nothing but finite numbers is promised."""
        if mode == "training":
            return math.inf
        less = self.whole if mode == "int8" and self.whole is not None else self.half
        return self.bound if mode == "float32" or less is None else less


CASES: list[Case] = []


def case(name: str, promise: str, unit: str, bound: float, half: float | None = None, whole: float | None = None):
    """Enter the decorated measurement into the table."""

    def enter(measure: Callable[[Subject], float]) -> Callable[[Subject], float]:
        CASES.append(Case(name, promise, unit, bound, measure, half, whole))
        return measure

    return enter


def scene(count: int = 3, seed: int = 0, noise: float = 1.0) -> list[Frame]:
    """A square sliding over a wall, 24×32."""
    return make_frames(count, seed=seed, noise=noise)


def still(count: int, noise: float) -> list[Frame]:
    """The first frame of the scene again and again; nothing moves, the noise is new in each."""
    frames = [scene(1, seed, noise)[0] for seed in range(count)] if noise else scene(1, 0, 0.0) * count
    quiet = torch.zeros_like(frames[0].motion)
    return [replace(f, motion=quiet, motion_next=quiet, number=i) for i, f in enumerate(frames)]


def broken(frame: Frame, layer: str, value: float) -> Frame:
    """One pixel of a layer replaced."""
    tensor = getattr(frame, layer).clone()
    tensor[..., AT[0], AT[1]] = value
    return replace(frame, **{layer: tensor})


def filled(frame: Frame, layer: str, value: float) -> Frame:
    return replace(frame, **{layer: torch.full_like(getattr(frame, layer), value)})


def greatest(a: list[Tensor], b: list[Tensor]) -> float:
    """The greatest difference of two runs."""
    return max((x - y).abs().max().item() for x, y in zip(a, b, strict=True))


def relative(a: Tensor, b: Tensor) -> float:
    """The greatest difference, relative to b, where b is dark to a tenth of its mean."""
    return ((a - b).abs() / b.abs().clamp(min=0.1 * b.abs().mean().item() + 1e-30)).max().item()


# Radiance

for bad, label in ((math.nan, "NaN"), (math.inf, "+Inf"), (-math.inf, "−Inf"), (-3.0, "negative")):

    @case(f"radiance {label} in a pixel", "as if that pixel were black", "greatest difference", 0.0)
    def _(subject: Subject, bad: float = bad) -> float:
        frames = scene()
        runs = [[frames[0], broken(frames[1], "radiance", value), frames[2]] for value in (bad, 0.0)]
        return greatest(*map(subject.play, runs))


@case("radiance NaN in all pixels of a frame", "as if that frame were black", "greatest difference", 0.0)
def _(subject: Subject) -> float:
    frames = scene()
    runs = [[frames[0], filled(frames[1], "radiance", value), frames[2]] for value in (math.nan, 0.0)]
    return greatest(*map(subject.play, runs))


@case("denormals in a tenth of the pixels", "as if they were black", "greatest relative difference", 1e-5, 1e-5)
def _(subject: Subject) -> float:
    frames = scene(2)
    tiny = torch.rand(frames[0].radiance[:, :1].shape, generator=torch.Generator().manual_seed(3)) < 0.1
    runs = [[replace(f, radiance=torch.where(tiny, value, f.radiance)) for f in frames] for value in (1e-41, 0.0)]
    return max(relative(a, b) for a, b in zip(*map(subject.play, runs), strict=True))


@case("all black", "black", "greatest value", 0.0)
def _(subject: Subject) -> float:
    return max(image.max().item() for image in subject.play([filled(f, "radiance", 0.0) for f in scene()]))


@case(
    "equal light on equal albedo", "unchanged: kernels sum to one, at borders too", "greatest relative difference", 1e-5
)
def _(subject: Subject) -> float:
    frames = [filled(filled(f, "radiance", 0.3), "albedo", 0.6) for f in scene()]
    return max(relative(image, torch.full_like(image, 0.3)) for image in subject.play(frames))


for scale in (1e-6, 1e-3, 1e3, 1e6):
    # Recent frames are kept in bfloat16, which rounds another exposure otherwise.
    @case(f"exposure × {scale:g}", "the same picture × that", "greatest relative difference", 6e-3, 0.2)
    def _(subject: Subject, scale: float = scale) -> float:
        frames = scene()
        scaled = subject.play([replace(f, radiance=f.radiance * scale) for f in frames])
        return max(relative(a / scale, b) for a, b in zip(scaled, subject.play(frames), strict=True))


def _after_firefly(subject: Subject, count: int) -> list[Tensor]:
    """How much brighter each pixel is, frame by frame, than without the firefly in the first one; relative."""
    frames = still(count, 1.0)
    clean = subject.play(frames)
    lit = subject.play([broken(frames[0], "radiance", FIREFLY), *frames[1:]])
    return [(a - b) / b.clamp(min=0.1 * b.mean().item()) for a, b in zip(lit, clean, strict=True)]


@case("one firefly of 1e7: spread", "twice as bright no farther than 14 pixels from it", "pixels", 14)
def _(subject: Subject) -> float:
    far = [max(abs(y - AT[0]), abs(x - AT[1])) for d in _after_firefly(subject, 3)
           for y, x in (d[0].amax(0) > 1).nonzero().tolist()]  # fmt: skip
    return max(far, default=0)


@case("one firefly of 1e7: duration", "no pixel twice as bright after 20 frames", "frames", 20)
def _(subject: Subject) -> float:
    seen = [i for i, d in enumerate(_after_firefly(subject, min(subject.frames, 25)), start=1) if d.max() > 1]
    return max(seen, default=0)


@case("one firefly of 1e7: the rest", "the exposure of the frame does not move", "relative", 0.15)
def _(subject: Subject) -> float:
    frame = scene(1)[0]
    return abs((exposure(broken(frame, "radiance", FIREFLY).radiance) / exposure(frame.radiance)).item() - 1)


for behind, where in ((0.0, "before nothing"), (1e-4, "before a wall of 1e-4")):

    @case(f"a small lamp {where}", "it keeps its light", "relative error of its middle", 0.25)
    def _(subject: Subject, behind: float = behind) -> float:
        light = torch.full((1, 3, 24, 32), behind)
        light[..., 8:16, 16:24] = 1.0
        images = subject.play([replace(frame, radiance=light) for frame in still(3, 0.0)])
        return max(abs(image[..., 10:14, 18:22].mean().item() - 1) for image in images)


@case("light of one primary colour", "its brightness stays", "relative", 0.1, whole=0.15)
def _(subject: Subject) -> float:
    frames, found = still(4, 1.0), []
    for colour in torch.eye(3).view(3, 1, 3, 1, 1):
        image = subject.play([replace(frame, radiance=frame.radiance * colour) for frame in frames])[-1]
        found.append(abs(image.mean().item() / (frames[0].reference * colour).mean().item() - 1))
    return max(found)


@case("1 % fireflies of 1e4", "none of their light is lost: they are the noise", "share of the light cut", 0.0)
def _(subject: Subject) -> float:
    frames = [_salted(frame, 0.01, 1e4) for frame in scene(3)]
    subject.play(frames)
    light = [(f.radiance.sum().item(), limit_fireflies(f.radiance).sum().item()) for f in frames]
    return max(1 - after / before for before, after in light)


def _salted(frame: Frame, share: float, value: float) -> Frame:
    chosen = torch.rand(frame.radiance[:, :1].shape, generator=torch.Generator().manual_seed(frame.number)) < share
    return replace(frame, radiance=torch.where(chosen, value, frame.radiance))


# Features

for layer, bad, same, label in (
    ("normal", math.nan, 0.0, "NaN normals"), ("depth", math.inf, 0.0, "infinite depth"),
    ("depth", -1.0, 0.0, "negative depth"), ("depth", math.nan, 0.0, "NaN depth"),
    ("albedo", math.nan, 0.0, "NaN albedo"), ("albedo", 1e6, GREATEST_ALBEDO, "albedo 1e6"),
):  # fmt: skip

    @case(f"{label} everywhere", f"as {layer} {same:g}", "greatest difference", 0.0)
    def _(subject: Subject, layer: str = layer, bad: float = bad, same: float = same) -> float:
        return greatest(*(subject.play([filled(f, layer, value) for f in scene()]) for value in (bad, same)))


for layer, value in (("normal", 0.0), ("depth", 0.0), ("albedo", 0.0), ("albedo", GREATEST_ALBEDO)):

    @case(f"{layer} {value:g} everywhere", "not brighter than the brightest input", "relative", 1.0)
    def _(subject: Subject, layer: str = layer, value: float = value) -> float:
        frames = [filled(f, layer, value) for f in scene()]
        return max(i.max().item() for i in subject.play(frames)) / max(f.radiance.max().item() for f in frames)


# Motion and history

for value in (math.nan, math.inf, 1e6, 3 * 32.0, OFF_SCREEN):

    @case(f"motion {value:g} everywhere", "no trace of history: as a first frame", "greatest difference", 0.0)
    def _(subject: Subject, value: float = value) -> float:
        before, now = scene(2)
        now = filled(now, "motion", value)
        return greatest(subject.play([before, now])[1:], subject.play([now]))


for value, label in ((0.5, "half a pixel"), (-0.5, "minus half a pixel"), (31.5, "to the very border")):

    @case(f"motion by {label}", "not brighter than the brightest input", "relative", 1.0)
    def _(subject: Subject, value: float = value) -> float:
        frames = [filled(f, "motion", value) for f in scene()]
        return max(i.max().item() for i in subject.play(frames)) / max(f.radiance.max().item() for f in frames)


@case("history of another size", "refused, one line", "not refused", 0)
def _(subject: Subject) -> float:
    _, history = subject.step(scene(1)[0])
    try:
        subject.step(scene(1)[0].crop(0, 0, 16, 16), history)
    except InputError as error:
        return float("\n" in str(error))
    return 1.0


@case("every other frame dropped", "no worse than without history", "error / error of single frames", 1.1, 1.2)
def _(subject: Subject) -> float:
    frames = scene(8)[::2]
    alone = [subject.play([frame])[0] for frame in frames]
    errors = [_error(images[1:], frames[1:]) for images in (subject.play(frames), alone)]
    return errors[0] / errors[1]


def _error(images: list[Tensor], frames: list[Frame]) -> float:
    return sum((i - f.reference).square().mean().item() for i, f in zip(images, frames, strict=True)) / len(images)


# Time


@case("static clean input, many frames", "a fixed point: no drift in the second half", "relative change",
      1e-3, 0.05, 0.1)  # fmt: skip
def _(subject: Subject) -> float:
    images = subject.play(still(subject.frames, 0.0))
    return relative(images[-1], images[subject.frames // 2])


@case("static clean input, many frames: error", "the fixed point is the input", "relative RMS", 0.5)
def _(subject: Subject) -> float:
    frames = still(min(subject.frames, 60), 0.0)
    image, reference = subject.play(frames)[-1], frames[0].reference
    return ((image - reference).square().mean().sqrt() / reference.mean()).item()


@case("static noisy input, many frames", "brightness does not drift", "relative", 0.2)
def _(subject: Subject) -> float:
    frames = still(min(subject.frames, 60), 1.0)
    images = subject.play(frames)[-10:]
    return abs(sum(i.mean().item() for i in images) / 10 / frames[0].reference.mean().item() - 1)


@case("exposure that alternates between × 4 and × ¼", "within the range of the input", "relative to the brightest", 1.0)
def _(subject: Subject) -> float:
    frames = [replace(f, radiance=f.radiance * (4.0, 0.25)[i % 2]) for i, f in enumerate(still(12, 1.0))]
    return max(i.max().item() for i in subject.play(frames)) / max(f.radiance.max().item() for f in frames)


@case("strobe: every other frame black", "black frames darker than lit ones", "mean / mean of lit frames", 1.0)
def _(subject: Subject) -> float:
    frames = [filled(f, "radiance", 0.0) if i % 2 else f for i, f in enumerate(still(12, 1.0))]
    means = [image.mean().item() for image in subject.play(frames)]
    return max(means[5::2]) / max(means[4::2])


# Sizes

for size in ((1, 1), (1, 9), (7, 1), (17, 5), (23, 31)):

    @case(f"{size[1]}×{size[0]} pixels", "as many come out", "missing", 0)
    def _(subject: Subject, size: tuple[int, int] = size) -> float:
        frames = [frame.crop(0, 0, *size) for frame in scene()]
        return sum(
            image.shape != frame.radiance.shape for image, frame in zip(subject.play(frames), frames, strict=True)
        )


# The two failure cases that the paper names (§6.4)


@case("paper's failure case: border of a panning camera", "what enters: twice a first frame's error at most",
      "error there / of single frames", 2.0)  # fmt: skip
def _(subject: Subject) -> float:
    speed, frames = 4, []
    wide = make_frames(1, W=32 + 4 * 10, noise=0.0)[0]
    for i in range(8):
        f = wide.crop(0, speed * i, 24, 32)
        noise = torch.empty(f.radiance.shape).exponential_(generator=torch.Generator().manual_seed(i))
        f = filled(filled(replace(f, radiance=f.reference * noise, number=i), "motion", 0.0), "motion_next", 0.0)
        f.motion[:, 0], f.motion_next[:, 0] = speed, -speed
        frames.append(f)
    entering = (slice(None), slice(None), slice(None), slice(32 - speed, 32))
    runs = subject.play(frames)[1:], [subject.play([f])[0] for f in frames[1:]]
    errors = [sum((i - f.reference)[entering].square().mean().item() for i, f in zip(run, frames[1:], strict=True))
              for run in runs]  # fmt: skip
    return errors[0] / errors[1]


@case("paper's failure case: fast object, dark to light", "what it uncovers: a first frame's error at most",
      "error there / of single frames", 1.0)  # fmt: skip
def _(subject: Subject) -> float:
    frames = _dark_object(8, speed=3)
    runs = subject.play(frames)[2:], [subject.play([f])[0] for f in frames[2:]]
    errors = []
    for run in runs:
        inside = [
            (i - f.reference).square() * m for i, f, m in zip(run, frames[2:], _uncovered(frames)[2:], strict=True)
        ]
        errors.append(sum(e.sum().item() for e in inside))
    return errors[0] / errors[1]


def _dark_object(count: int, speed: int) -> list[Frame]:
    """A black square, six pixels wide, crosses a bright wall."""
    frames = []
    for i in range(count):
        base = still(i + 1, 1.0)[i]
        x = torch.arange(32).reshape(1, 1, 1, 32).expand(1, 1, 24, 32)
        inside = (x >= 2 + speed * i) & (x < 8 + speed * i)
        shift = torch.tensor([float(speed), 0.0]).reshape(1, 2, 1, 1)
        wall = torch.full_like(base.reference, 2.0)
        noise = base.radiance / base.reference.clamp(min=1e-6)
        reference = torch.where(inside, 0.01, wall)
        frames.append(replace(
            base, radiance=reference * noise, reference=reference,
            albedo=torch.where(inside, 0.1, 0.8).expand(1, 3, -1, -1),
            depth=torch.where(inside, 3.0, 8.0), motion=torch.where(inside, -shift, 0.0),
            motion_next=torch.where(inside, shift, 0.0),
        ))  # fmt: skip
    return frames


def _uncovered(frames: list[Frame]) -> list[Tensor]:
    before = [frames[0], *frames[:-1]]
    return [((b.depth == 3) & (f.depth == 8)).float() for b, f in zip(before, frames, strict=True)]
