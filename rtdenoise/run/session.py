"""`rtdenoise.Denoiser`: one call a frame, for programs that have their frames in memory."""

from __future__ import annotations

import warnings
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..frame import CHANNELS, MAX_CUT_MISMATCH, Frame, geometry
from .arrays import Form, from_planes, to_planes
from .backends import open_backend
from .choice import LEAST, candidates
from .following import Following
from .options import AUTO, check_lookahead, check_samples
from .stand_ins import COSTS, STAND_INS, with_stand_ins
from .threads import set_defaults

if TYPE_CHECKING:
    from torch import Tensor


class Denoiser:
    """A denoiser with its own history: call it once for each frame of an animation, in order.

        denoiser = rtdenoise.Denoiser()
        clean = denoiser(color, albedo=albedo, normal=normal, depth=depth, motion=motion, motion_next=motion_next)

    Arrays are numpy or torch, floats of any width, `[H, W, C]` or `[B, C, H, W]` (depth also `[H, W]`); the result has
    the kind, layout, dtype and device of `color`. Row 0 is on top, x points right, y down.

    | argument    | C | content                                                                                   |
    |-------------|---|-------------------------------------------------------------------------------------------|
    | color       | 3 | noisy radiance: linear, scene-referred, unbounded; the beauty, or indirect light alone    |
    | albedo      | 3 | in [0, 1]                                                                                 |
    | normal      | 3 | world space, in [-1, 1]                                                                   |
    | depth       | 1 | distance from the camera, > 0; 0 or inf where nothing was hit                             |
    | motion      | 2 | (x, y) in pixels, previous minus current: where the surface was, seen from here           |
    | motion_next | 2 | (x, y) in pixels, next minus current: where it will be                                    |

    Only `color` is required; a warning names the cost of a missing layer once. `rtdenoise.screen_motion` computes
    motion from positions and cameras. History starts anew after `reset()`, after a call that raised an error, after a
    cut (`detect_cuts`), where a frame has another size than the one before, and where it has no motion, for all
    pictures of a batch together. Frames that `lookahead` has delayed are tried once more after an error; those that
    raise it again never come. Arguments are copied, results are yours to change.
    """

    def __init__(
        self,
        model: str | Path = AUTO,
        *,
        backend: str = "auto",
        device: str = "auto",
        precision: str = "auto",
        detect_cuts: bool = True,
        detect_exposure: bool = True,
        correct: bool = False,
        samples: int = 0,
        lookahead: int = 0,
        more_history: bool = False,
    ) -> None:
        """`model` is the name of a model that ships ('hybrid', 'default', 'fast' ...) or a .safetensors file; 'auto'
        makes the best picture: 'hybrid', or from 4 `samples` a pixel on 'hybrid-many'; with glsl and `correct`
        'default' and 'many', which take less than half of the time.

        `backend` is 'torch', 'glsl' (OpenGL shaders, without PyTorch; one picture at a time), or 'auto': torch where it
        is installed. `device` is torch's, 'cpu', 'cuda' or 'auto', and the network's `precision` 'fp32', 'bf16', 'int8'
        (with glsl 'fp16') or 'auto'. `detect_cuts` starts history anew where most pixels find another surface than
        their motion promises; `detect_exposure` finds out how much brighter or darker the picture becomes as a whole,
        and makes history as bright (with PyTorch). `correct` corrects each frame by the noisy ones before it, for 4
        samples a pixel and more; `samples` says how many there are, so that edges are corrected, too. With `lookahead`
        each frame is denoised with so many frames after it: a call returns the picture of the frame so many calls
        before, None at first, and `flush` the last ones. `more_history`: networks for many samples take more history,
        as of frames of Cycles.

        Raises InputError for an unknown model, backend, device or precision, a correction without torch, `samples`
        beyond all sense or that nothing goes by, and a `lookahead` out of range or with a model that averages no light.
        """
        set_defaults()
        check_samples(samples, "samples")
        if samples and not correct and model != AUTO:
            raise InputError(f"samples={samples}: goes with model='auto' or correct=True")
        if model == AUTO:
            few, many = candidates(backend, correct)
            model = few if samples < LEAST else many
        self.started = True
        """Whether the last call started history anew."""
        self._detect_cuts = detect_cuts
        check_lookahead(lookahead, "lookahead")
        opened = open_backend(backend, str(model), device, precision, correct, lookahead=lookahead)
        self._backend = Following(opened, detect_exposure)
        self._samples, self._history = samples if correct else 0, None
        self._more_history = more_history
        self._delayed = None  # with `lookahead`; then the history is that of cuts alone
        if lookahead:
            from .lookahead import Delayed

            self._delayed = Delayed(self._backend, lookahead)
        self._forms: deque[Form] = deque()  # of the frames whose picture is yet to come
        self._shape: tuple[int, ...] = ()  # of the frame before, for which the plan is
        self._count = 0  # frames so far
        self._said: set[str] = set()

    def __call__(
        self,
        color: np.ndarray | Tensor,
        *,
        albedo: np.ndarray | Tensor | None = None,
        normal: np.ndarray | Tensor | None = None,
        depth: np.ndarray | Tensor | None = None,
        motion: np.ndarray | Tensor | None = None,
        motion_next: np.ndarray | Tensor | None = None,
    ) -> np.ndarray | Tensor | None:
        """The next frame, denoised: an array like `color`. See `help(rtdenoise.Denoiser)` for the arguments. With
        `lookahead` the frame so many calls before; None at first.

        Raises InputError, in one line, for arrays of other shapes, integers, and layers of another size than `color`.
        """
        before, self._history = self._history, None  # should this frame fail, the next one begins a shot
        given = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion, "motion_next": motion_next}
        radiance, form = to_planes("color", color, CHANNELS["radiance"])
        layers = {name: to_planes(name, x, CHANNELS[name])[0] for name, x in given.items() if x is not None}
        for name, planes in layers.items():
            _expect_size(name, tuple(planes.shape), tuple(radiance.shape))
        frame = self._completed(radiance, layers)
        history = self._kept(frame, before)
        prepared = self._backend.prepare(frame)
        if self._detect_cuts and history is not None and self._backend.mismatch(prepared, history) > MAX_CUT_MISMATCH:
            history = None
        self.started, self._count = history is None, self._count + 1
        if self._delayed is None:
            image, self._history = self._backend.denoise(prepared, history)
            return from_planes(image, form)
        if history is None:
            self._end_shot()
        image = self._delayed.add(prepared)
        self._history = geometry(prepared)
        self._forms.append(form)
        return None if image is None else from_planes(image, self._forms.popleft())

    def flush(self) -> list[np.ndarray | Tensor]:
        """With `lookahead`, the frames that are yet to come, in order, at the end of an animation. The next frame
        starts a new shot."""
        self._history = None
        if not self._delayed:
            return []
        self._end_shot()
        return [from_planes(image, self._forms.popleft()) for image in self._delayed.flush()]

    def reset(self) -> None:
        """Forget the frames so far: the next one starts a new shot. What `lookahead` has delayed still comes."""
        self._history = None

    def __reduce_ex__(self, protocol: int) -> Any:
        raise TypeError("a rtdenoise.Denoiser can be neither pickled nor copied, as it holds memory of its device; "
                        "make another one, in each process its own")  # fmt: skip

    def _end_shot(self) -> None:
        """Denoise what `lookahead` has delayed without the frames after; what cannot be is given up."""
        try:
            self._delayed.end_shot()
        finally:
            while len(self._forms) > self._delayed.ready:
                self._forms.pop()

    def _completed(self, radiance: np.ndarray | Tensor, layers: dict[str, np.ndarray | Tensor]) -> Frame:
        """The frame, with each missing layer that the networks read replaced by a constant."""
        for name in STAND_INS:
            if name not in layers:
                self._say(name, f"no {name}: {COSTS[name]}")
        if "motion_next" not in layers and "motion" in layers:
            self._say("motion_next", f"no motion_next: {COSTS['motion_next']}")
        name, more = f"frame {self._count}", self._more_history
        frame = Frame(radiance, **layers, number=self._count, name=name, more_history=more)
        return with_stand_ins(frame.with_samples(self._samples))

    def _kept(self, frame: Frame, before: Any) -> Any:
        """What this frame may use of the history of the frame before; None where it starts anew."""
        shape, shape_before = tuple(frame.radiance.shape), self._shape
        if shape != shape_before:
            if self._delayed:
                self._end_shot()  # by the plan of its size
            self._backend.plan(frame.size, 2, [], {})
            self._shape = shape
        if before is None:
            return None
        if shape != shape_before:
            self._say(
                "size", f"the frame is {list(shape)}, the one before was {list(shape_before)}: history starts anew"
            )
            return None
        if frame.motion is None:
            self._say("motion", f"no motion: {COSTS['motion']}; rtdenoise.screen_motion computes it, "
                      "zeros say that nothing moves")  # fmt: skip
            return None
        return before

    def _say(self, about: str, message: str) -> None:
        """Warn once about one thing."""
        if about not in self._said:
            self._said.add(about)
            warnings.warn(f"rtdenoise: {message}", stacklevel=4)


def _expect_size(name: str, found: tuple[int, ...], color: tuple[int, ...]) -> None:
    if (found[0], *found[2:]) != (color[0], *color[2:]):
        raise InputError(f"{name}: expected {color[3]}×{color[2]} as color (batch of {color[0]}), got "
                         f"{found[3]}×{found[2]} (batch of {found[0]})")  # fmt: skip
