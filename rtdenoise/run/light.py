"""`denoise --lights` and `--also`: a backend whose steps denoise the light of a frame in parts.

Each light is denoised as a picture of its own, by its own noise, with the surfaces of the frame; diffuse and glossy
light with the colour of their lobe as albedo. So is the whole. Their sum and the whole err in different places: the
picture is a mixture of both, as the noisy frame tells (`ops.mix`), and the light passes are scaled, in each pixel
alike, so that they add up to it. Emission, environment and colours have no noise: their edges are smoothed as the
whole's (`models.noiseless`).
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.light import LightPasses, read_light
from ..data.sequences import Sequence
from ..data.soft_edges import with_soft_edges
from ..data.stored import OF
from ..errors import InputError
from ..frame import NOTHING_KNOWN, Frame, History
from ..sanitise import GREATEST_ALBEDO
from .following import Following, unfollowed
from .memory import explained
from .offline_picture import Picture
from .parts import BACKGROUND, Parts, check_sign, compare_sum, shared_out, sum_of, valid, whole_groups
from .plan import Plan, count, look
from .shadows import SHADOWS, Shadows
from .surfaces import light_seen
from .torch_backend import TorchBackend

if TYPE_CHECKING:
    from torch import Tensor

    from ..models.presets import Config

PICTURE = ""  # the name of the sum of all light
OWN = "Diffuse", "Glossy"  # lobes whose colour is their albedo; in glass the frame's is that of what shows behind it
SHARES = 0.5, 0.0, 0.0  # of `mix`: usually half of the picture as a whole, half of the sum of its lights
GROUP = "Combined_"  # how the names of Cycles' light groups begin

Histories = dict[str, Any]  # of the picture, and of each light by name that was ever there in the shot


class LightBackend:
    """A `Backend` around torch's. An image is a dict of `[1, 3, H, W]`: the picture, named `PICTURE`, and the passes; a
    history is `Histories`."""

    settles = False  # passes are to add up to the picture

    def __init__(
        self,
        inner: TorchBackend,
        passes: LightPasses,
        told: str = "--lights",
        picture: Picture | None = None,
        soft_edges: bool = False,  # frames get them, each light for itself
        detect_exposure: bool = False,  # likewise each light's brightness is followed
        shadows: Shadows | None = None,
    ) -> None:
        from ..models.accumulated_kpn import AccumulatedKPN

        self._network = inner.network
        if not isinstance(self._network, AccumulatedKPN):
            raise InputError(f"{told}: goes with --model hybrid, default, many or fast, which average light")
        self._network.keeps_trust = False
        self._passes, self._picture, self._soft, self._device = passes, picture, soft_edges, inner.device
        self._inner, self._waits = Following(inner, detect_exposure), inner.waits
        self._shadows = shadows
        self._stored: dict[str, np.ndarray] = {}  # the passes of the frame that was read last
        self._seen: dict[str, np.ndarray] = {}  # likewise those without noise, as a shutter sees them
        self._parts: dict[int, Parts] = {}  # by number, of the frames that are prepared
        self._left_out: dict[str, int] | None = None
        self._checked = False  # whether the passes add up

    @property
    def config(self) -> Config:
        """As the inner backend's."""
        return self._inner.config

    @property
    def ran(self) -> dict[str, str]:
        """As the inner backend's."""
        return self._inner.ran

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        self._left_out = left_out
        if self._shadows:
            self._shadows.backend.plan(size, frames, first, {})
        return self._inner.plan(size, frames, first, {})  # a frame counts once, whatever its parts

    def read(self, sequence: Sequence, index: int) -> Frame:
        """A frame; its passes are kept for `prepare`, which comes next."""
        self._stored = read_light(sequence, index, self._passes)
        self._seen = light_seen(sequence, index, self._passes)
        return replace(sequence, soft_edges=False).read(index)

    def prepare(self, frame: Frame) -> Frame:
        """The frame; its parts are kept for `step`."""
        import torch

        ready, passes = self._inner.prepare(self._shown(frame, frame.radiance)), self._passes
        for name in passes.also:
            check_sign(ready.name, name, self._stored[name])
        stored = {name: valid(x) for name, x in self._stored.items()}
        stored |= passes.radiance(stored)
        picture = valid(np.asarray(frame.radiance))
        summands = {name: stored[name] for name in passes.summands}
        stored |= {name: 1 - stored[name].clip(max=1) for name in passes.alpha}
        with explained(ready.name, ready.size, self._device):
            lights = {name: self._inner.prepare(Frame(self._shown(frame, stored[name]).radiance)).radiance
                      for name in self._streams}  # fmt: skip
            seen = stored | self._seen
            passed = {name: self._on_device(seen[name]) for name in (*passes.colors, *passes.passed)}
        lobes = {name: name.split()[0] for name in passes.lights}
        albedo = {name: passed[lobe].clamp(max=GREATEST_ALBEDO) for name, lobe in lobes.items() if lobe in OWN}
        albedo |= dict.fromkeys(passes.alpha, torch.ones_like(ready.radiance))
        complete = background = True
        if summands:
            first, self._checked = not self._checked, True
            complete, background = compare_sum(ready.name, picture, summands, passes, must=first)
        groups = whole_groups(picture, {n: stored[n] for n in passes.also if n.startswith(GROUP)})
        self._parts[ready.number] = Parts(lights, albedo, passed, complete, background, groups)
        return ready

    def mismatch(self, frame: Frame, history: Histories | History) -> float:
        """As the inner backend's; `history` may be a frame's `geometry` alone."""
        return self._inner.mismatch(frame, history if isinstance(history, History) else history[PICTURE])

    def gain(self, history: Histories) -> float:
        """That of the picture."""
        return self._inner.gain(history[PICTURE])

    def step(
        self, frame: Frame, history: Histories | None, ahead: tuple[Frame, ...] = ()
    ) -> tuple[dict[str, np.ndarray], Histories]:
        found, history = self.denoise(frame, history, ahead)
        return {name: image.cpu().numpy() for name, image in found.items()}, history

    def denoise(
        self, frame: Frame, history: Histories | None, ahead: tuple[Frame, ...] = ()
    ) -> tuple[dict[str, Tensor], Histories]:
        import torch

        before, parts = history or {}, self._parts[frame.number]
        with torch.inference_mode(), explained(frame.name, frame.size, self._device):
            picture, passed, after = self._whole(frame, parts, before.get(PICTURE), ahead)
            if self._picture:
                picture = self._on_device(self._picture.read(frame.number))
            found, after = passed, {PICTURE: after}
            for name, light in parts.lights.items():
                if name not in before and not light.any():
                    found[name] = light
                    continue
                following = tuple(self._parts[f.number].lit(f, name) for f in ahead)
                found[name], after[name] = self._of(name).denoise(parts.lit(frame, name), before.get(name), following)
            if self._passes.lights:
                found, picture = self._added_up(frame, found, picture, parts)
            found |= shared_out(picture, {name: found[name] for name in parts.groups})
        self._parts = {number: kept for number, kept in self._parts.items() if number > frame.number}
        return found | {PICTURE: picture}, after

    def _whole(
        self, frame: Frame, parts: Parts, history: History | None, ahead: tuple[Frame, ...]
    ) -> tuple[Tensor, dict[str, Tensor], History]:
        """The picture, the layers without noise, and the history."""
        import torch

        from ..models import noiseless

        known, its = NOTHING_KNOWN, unfollowed(history)
        if self._left_out is not None:
            known = look(frame, its and its.motion_next, history is not None)
            count(self._left_out, known, keeps_means=True)
        if not parts.passed:
            picture, after = self._inner.denoise(frame, history, ahead)
            return picture, {}, after
        given = self._inner.enter(frame, history, ahead)
        known = replace(known, first=known.first and not ahead, sanitised=True, ahead=given.ahead, waits=self._waits)
        layers = dict(parts.passed)
        if not parts.background:
            layers[BACKGROUND] = torch.zeros_like(layers[BACKGROUND])
        shown = torch.cat([*layers.values()], 1)
        picture, smooth, after = noiseless.step(self._network, given.frame, shown, given.history, known)
        return given.shown(picture), dict(zip(layers, smooth.split(3, dim=1), strict=True)), given.left(after)

    def _added_up(
        self, frame: Frame, found: dict[str, Tensor], picture: Tensor, parts: Parts
    ) -> tuple[dict[str, Tensor], Tensor]:
        """The passes with lights scaled towards the mixture of the picture and their sum, and the picture that is their
        sum then: that mixture, but where emission or environment are part of it. In a frame to which they do not add
        up, they are scaled towards the picture."""
        import torch

        from ..exposure import exposure
        from ..ops.mix import mix

        total, ones = sum_of(found[name] for name in self._passes.summands), torch.ones_like(frame.depth)
        if parts.complete:
            scale = exposure(picture)
            picture = mix(picture, total, scale, ones, SHARES, noisy=frame.radiance, tells=ones)
        scale = torch.where(total > 0, picture / total, 1)
        lit = {name: scale * found[name] for name in (*self._passes.lights, *self._passes.volumes)}
        found = found | lit
        picture = sum_of(found[name] for name in self._passes.summands)
        if not parts.background:
            del found[BACKGROUND]  # the layer stays as it is
        return found, picture

    def save(self, history: Histories) -> dict[str, np.ndarray]:
        fields = self._inner.save(history[PICTURE])
        for place, name in enumerate(self._streams):
            if name in history:
                fields |= {f"{place}{OF}{field}": x for field, x in self._of(name).save(history[name]).items()}
        return fields

    def restore(self, fields: Mapping[str, np.ndarray]) -> Histories:
        kept: dict[str, dict[str, np.ndarray]] = {}
        streams = dict(enumerate(self._streams))
        for name, array in fields.items():
            place, _, field = name.rpartition(OF)
            kept.setdefault(streams[int(place)] if place else PICTURE, {})[field] = array
        return {name: self._of(name).restore(of_it) for name, of_it in kept.items()}

    def remember(self, history: Histories, frames: SequenceOf[Frame]) -> Histories:
        remembered = {}
        for name, its in history.items():
            seen = [frame if name == PICTURE else self._parts[frame.number].lit(frame, name)
                    for frame in frames[: len(unfollowed(its).recent) + 1]]  # fmt: skip
            remembered[name] = self._of(name).remember(its, seen)
        return remembered

    def _shown(self, frame: Frame, light: np.ndarray) -> Frame:
        """The frame with a light as denoisers take it."""
        frame = replace(frame, radiance=light)
        return with_soft_edges(frame) if self._soft else frame

    @property
    def _streams(self) -> list[str]:
        return [*self._passes.lights, *self._passes.volumes, *self._passes.also, *self._passes.alpha]

    def _of(self, name: str) -> Following:
        """What denoises a light."""
        return self._shadows.backend if self._shadows and name == SHADOWS else self._inner

    def _on_device(self, image: np.ndarray) -> Tensor:
        import torch

        return torch.from_numpy(image).to(self._device)
