"""The protocol of every denoiser: all that training, evaluation, tiles and the plan ask of a network."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from ..frame import NOTHING_KNOWN, Frame, History, Known
from .losses import Loss
from .presets import Config


class Denoiser(Protocol):
    """A `torch.nn.Module` that denoises a sequence frame by frame. State is explicit: each step returns the history
    that the next one takes."""

    config: Config

    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[Tensor, History]:
        """Denoise one frame: `[B, 3, H, W]` linear radiance, and the history for the next frame.

        `frame` needs radiance, albedo, normal, depth and, unless `history` is None, motion. `history=None` starts a
        sequence, or starts anew after a cut. Without `motion_next` in the previous frame dual motion is approximated
        from this frame's motion and both depths. `known` facts are trusted: they save the work of finding them out.
        The picture is part of the history: whoever changes it in place changes the next frame.

        Raises InputError where a layer is missing, the history has another size or is none, or `frame` is no Frame of
        tensors.
        """

    def statistics(self, frame: Frame) -> tuple[Tensor, Tensor]:
        """Numbers that `step` takes from a frame as a whole, `[B, 1, 1, 1]` each: its exposure, and the mean distance
        of its surfaces. A window of the frame is denoised with those of the whole (`frame.Known`)."""

    def loss(
        self,
        image: Tensor,  # [B, 3, H, W] the denoised frame
        frame: Frame,  # with its reference
        previous: tuple[Tensor, Tensor] | None,  # image and reference of the frame before; None at a start
        occlusion: Tensor | None,  # [B, 1, H, W] weights of uncovered pixels; None: without that term
        scale: Tensor | float,  # [B, 1, 1, 1] exposure of the loss
        huber: float,  # error up to which the loss is quadratic
    ) -> Loss:
        """The training loss of one frame, of each image of the batch."""
