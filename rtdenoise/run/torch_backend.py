"""The backend that runs a model in torch: recorded on a GPU, by the plan, at the network's precision."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..constants import RECALL_FRAMES, RECALL_FRAMES_OF_PASS, RECALL_RESET
from ..data.stored import of_resets, with_resets
from ..errors import InputError
from ..frame import Frame, History, Known
from ..models.presets import Config
from .lookahead import SETTLES_FROM
from .memory import explained
from .once import SURFACES, Once
from .plan import Plan, make_plan

if TYPE_CHECKING:
    from torch import Tensor

    from ..models import Denoiser


class TorchBackend:
    """A `backends.Backend` of `rtdenoise.models`."""

    def __init__(
        self,
        model: str,
        device: str,
        precision: str,
        correct: bool = False,
        footprint: bool = False,
        lookahead: int = 0,
    ) -> None:
        """`footprint`: the histories of a network that averages light have one, for the offline mode, of
        `RECALL_FRAMES_OF_PASS` frames. `lookahead`: frames after each one that there will be (`lookahead.direct`);
        networks that keep none then keep `RECALL_FRAMES`, as those of many samples do for a footprint. Raises
        InputError where one cannot."""
        import torch

        from ..history import advanced
        from ..models import load
        from ..models.hybrid import Hybrid
        from ..models.inference import choose_device
        from ..models.past import coming, of_many, turning
        from .graphs import stepper

        self.device = choose_device(device)
        with torch.autocast(self.device, enabled=False):
            self._denoiser = load(model, self.device, precision)
        if correct and self._denoiser.config.motion is None:
            raise InputError(f"{model}: denoises single pictures, and the correction needs the frames before")
        averages = "mean" in self._denoiser.config.carries
        if lookahead and not averages:
            raise InputError(f"lookahead: model {model!r} does not average light over time; choose hybrid, default, "
                             "many or fast")  # fmt: skip
        self._correct = correct
        config = self._denoiser.config
        if averages and (footprint or (lookahead and not config.recent)):
            most = RECALL_FRAMES_OF_PASS if footprint and not of_many(config) else RECALL_FRAMES
            most = min(most, math.ceil(config.longest) - 1)  # below the longest history
            self._denoiser.config = replace(config, recent=most, footprint=footprint or config.footprint)
            if isinstance(self._denoiser, Hybrid):
                self._denoiser.keeps_footprint = footprint
        self.settles = lookahead >= SETTLES_FROM and not correct
        if averages:
            self._denoiser.keeps_trust = self.settles or footprint
        self._step = self._whole = stepper(self._denoiser)
        self.waits = lookahead > 0  # `Known.waits`
        self._advanced, self._turning = Once(advanced, lookahead), Once(turning, lookahead)
        pairs = max(1, lookahead - self.settles - 1)  # of the frames that a step is given, each of as much memory
        self._coming = Once(lambda a, b: coming(self.config, a, self._turning(a, b)), pairs, ("radiance", *SURFACES))

    @property
    def config(self) -> Config:
        """The configuration of its network."""
        return self._denoiser.config

    @property
    def ran(self) -> dict[str, str]:
        from ..models.loading import precision_of

        return {"backend": "torch", "device": self.device, "precision": precision_of(self._denoiser)}

    @property
    def network(self) -> Denoiser:
        """Its network, a torch module."""
        return self._denoiser

    @contextmanager
    def _inference(self, frame: Frame) -> Iterator[None]:
        """Without gradients, and at the network's precision whatever the caller's autocast is."""
        import torch

        plain = torch.autocast(self.device, enabled=False)
        with torch.inference_mode(), plain, explained(frame.name, frame.size, self.device):
            yield

    def prepare(self, frame: Frame) -> Frame:
        import torch

        from ..sanitise import sanitise

        with self._inference(frame):
            return sanitise(frame.map(partial(torch.as_tensor, device=self.device)))

    def step(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        image, history = self.denoise(frame, history, ahead)
        with self._inference(frame):
            return image.cpu().numpy(), history

    def denoise(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[Tensor, Any]:
        from ..history import going_ahead
        from ..models.shrinkage import corrected

        step = self._step if len(frame.radiance) == 1 else self._whole  # the plan is for single pictures
        step = corrected(step) if self._correct else step
        with self._inference(frame):
            pairs = tuple(pairwise(ahead)) if self.device == "cpu" else ()
            turning, coming = (tuple(found(a, b) for a, b in pairs) for found in (self._turning, self._coming))
            known = Known(sanitised=True, ahead=ahead, turning=turning, coming=coming, waits=self.waits)
            return going_ahead(step, self._advanced)(frame, history, known)

    def settled(self, frame: Frame, after: History, following: Frame, after_following: History) -> Tensor:
        from ..models.settled import settled

        with self._inference(frame):
            return settled(after, after_following, self._advanced(following, frame))

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        from .planned import Planned

        config = self._denoiser.config
        windows = config.network_reach is not None
        motion = "dual" if self.waits else config.motion  # frames after are led to by motion_next
        plan = make_plan(size, frames, motion, first, windows, config.reads)
        planned = Planned(self._denoiser, plan, self._whole)
        left_out |= planned.left_out | left_out  # the counts of earlier runs, where there are any
        planned.left_out, self._step = left_out, planned.step
        return plan

    def mismatch(self, frame: Frame, history: Any) -> float:
        from ..history import mismatch

        if self.config.motion is None:
            return 0.0  # history leaves no trace
        with self._inference(frame):
            return mismatch(frame, history).max().item()

    def save(self, history: Any) -> dict[str, np.ndarray]:
        layers = replace(history, recent=(), footprint=None, footprint_count=None, trusted=None, noisy=None).layers()
        fields = {name: tensor.cpu().contiguous().numpy() for name, tensor in layers.items()}
        resets = (kept[:, RECALL_RESET, None].cpu().contiguous().numpy() for kept in history.recent)
        return fields | of_resets(resets)

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        from ..history import from_arrays

        history = from_arrays(with_resets(fields), self.device)
        there = {name.partition(".")[0] for name in history.layers()}
        wanted = "depth", "normal", *self.config.carries, *(("residual", "residual_length") if self._correct else ())
        if missing := [name for name in wanted if name not in there]:
            raise InputError(f"the history has no {missing[0]}")
        return history

    def remember(self, history: Any, frames: Sequence[Frame]) -> Any:
        import torch

        from ..history import advance
        from ..models.moved_light import shift_of
        from ..models.past import kept
        from ..ops.kept import kept_nearer, nearer

        if not frames or "mean" not in self.config.carries:
            return history
        with torch.inference_mode():
            recent, ahead = [], []  # `ahead`: how far the camera has gone since each of these, a step each
            for i, frame in enumerate(frames[: len(history.recent)]):
                shift, steps = None, list(reversed(ahead))
                if i + 1 < len(frames) and frame.motion is not None:
                    before = frames[i + 1]
                    ahead.append(advance(frame, before.depth, before.normal))
                    depth = nearer(before.depth, ahead[-1])
                    shift = shift_of(frame, before.radiance, depth, history.shifts[i + 1 : i + 2])
                recent.append(kept(self.config, frame, torch.zeros_like(frame.depth), shift=shift))
                for by in steps:
                    recent[i] = kept_nearer(recent[i], by) if by.any() else recent[i]
            for its, resets in zip(recent, history.recent, strict=True):
                its[:, RECALL_RESET] |= resets[:, RECALL_RESET]
            return replace(history, noisy=frames[0].radiance, recent=tuple(recent))
