"""`denoise --lights` and `--also`: a backend whose steps denoise the light of a frame in parts (`models.parts`).

Diffuse light is divided by the diffuse colour. Gloss and transmission are divided by the denoising albedo instead,
which follows mirrors and glass to the surface that is seen in them: with their own colours a reflected texture blurs.
"""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.light import LightPasses, find_light, read_light
from ..data.light_output import write_light
from ..data.sequences import Sequence
from ..errors import INSTALL_TORCH, InputError
from ..frame import NOTHING_KNOWN, Frame
from .backends import Backend, TorchBackend
from .memory import explained
from .options import Options
from .plan import Plan, count, look, make_plan

if TYPE_CHECKING:
    from torch import Tensor

    from ..models.parts import Parts
    from ..models.presets import Config

OWN_COLOR = "Diffuse"  # the lobe whose light is divided by its own colour
MAX_NEGATIVE = 0.1  # of the light in a layer of `--also`; filters of some renderers have lobes below 0
MAX_APART = 0.02  # of the mean radiance; half floats round by less than 0.001
PICTURE = ""  # the name of the sum of all light
BACKGROUND = "Environment"  # with a transparent film Cycles leaves it out of Combined
GROUP = "Combined_"  # how the names of Cycles' light groups begin


def in_parts(sequence: Sequence, options: Options, backend: Backend) -> tuple[Backend, Any, Any]:
    """A backend for light in parts around `backend`, and the functions that read its frames and write its results.

    Raises InputError for options that do not go together, and as `find_light`.
    """
    told = "--lights" if options.lights else "--also"
    if options.signal != "color":
        raise InputError(f"{told}: goes with --signal color, not {options.signal}")
    if options.keep:
        raise InputError(f"{told}: goes without --keep; --layout source passes every channel on")
    passes = find_light(sequence, options.lights, options.also)
    if not isinstance(backend, TorchBackend):
        raise InputError(f"{told}: goes with --backend torch; {INSTALL_TORCH}")
    lit = LightBackend(backend, passes, each=options.layout == "source", told=told)
    return lit, lit.read, partial(_write, passes=passes, layout=options.layout, float32=options.float32)


def _write(
    out: Path, sequence: Sequence, index: int, _: Frame, image: dict[str, np.ndarray], **options
) -> dict[str, int]:
    parts = {name: part for name, part in image.items() if name != PICTURE}
    return write_light(out, sequence, index, picture=image[PICTURE], parts=parts, **options)


@dataclass(frozen=True)
class Prepared:
    """A frame with its light in parts, and the names of their outputs."""

    frame: Frame
    parts: Parts
    names: tuple[str, ...]
    background: bool = True  # whether it is in the picture
    groups: tuple[str, ...] = ()  # the light groups, where they add up to the picture


class LightBackend:
    """A `Backend` around torch's. An image is a dict of `[1, 3, H, W]`: the whole, named `PICTURE`, and the passes."""

    def __init__(self, inner: TorchBackend, passes: LightPasses, each: bool, told: str = "--lights") -> None:
        """`each`: every pass is a result; else the picture and the layers of `also`."""
        from ..models.accumulated_kpn import AccumulatedKPN

        self.network = inner.network
        if type(self.network) is not AccumulatedKPN:  # `hybrid` writes pixels: not linear in the light
            raise InputError(f"{told}: goes with --model default, many or fast, which filter irradiance")
        if self.network.config.recent:
            raise ValueError("light in parts needs a running mean: TorchBackend(..., recent=0)")
        self._inner, self._passes, self._each = inner, passes, each
        self._stored: dict[str, np.ndarray] = {}  # the passes of the frame that was read last
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
        return make_plan(size, frames, self.network.config.motion, first, windows=False)

    def read(self, sequence: Sequence, index: int) -> Frame:
        """A frame; its passes are kept for `prepare`, which comes next."""
        self._stored = read_light(sequence, index, self._passes)
        return sequence.read(index)

    def prepare(self, frame: Frame) -> Prepared:
        import torch

        ready, device = self._inner.prepare(frame), self._inner.device
        with torch.inference_mode(), explained(ready.name, ready.size, device):
            images = {name: torch.from_numpy(image).to(device) for name, image in self._stored.items()}
            for name in self._passes.also:
                _check_sign(ready.name, name, images[name])
            images = {name: _valid(image) for name, image in images.items()}
            noisy = torch.as_tensor(frame.radiance).to(device)
            # Fireflies are dimmed in the parts as in the whole.
            dimmed = torch.where(ready.radiance < noisy, ready.radiance / noisy, 1.0)
            for name in images.keys() - self._passes.colors.keys():
                images[name] = images[name] * dimmed
            background, groups = True, ()
            if self._passes.lights:
                groups = _whole_groups(ready, images, self._passes)
                apart, background = _compare_sum(ready, images, self._passes)
                if not self._checked:
                    _check_sum(ready, apart, self._passes)
                    self._checked = True
                if not background:
                    images[BACKGROUND] = torch.zeros_like(images[BACKGROUND])
        return Prepared(ready, *split(images, self._passes, self._each), background, groups)

    def mismatch(self, frame: Prepared, history: Any) -> float:
        return self._inner.mismatch(frame.frame, history)

    def step(self, frame: Prepared, history: Any, ahead: tuple = ()) -> tuple[dict[str, np.ndarray], Any]:
        import torch

        from ..models.parts import step

        ready, known = frame.frame, NOTHING_KNOWN
        if self._left_out is not None:
            known = look(ready, history and history.motion_next, history is not None)
            count(self._left_out, known, keeps_means=True)
        known = replace(known, sanitised=True)
        with torch.inference_mode(), explained(ready.name, ready.size, self._inner.device):
            whole, outputs, history = step(self.network, ready, frame.parts, history, known)
            found = dict(zip(frame.names, outputs.split(3, dim=1), strict=True))
            if PICTURE not in found:
                lights = self._passes.summands
                found[PICTURE] = sum(found[name] for name in lights) if lights else whole
            found |= _shared_out(found[PICTURE], {name: found[name] for name in frame.groups})
            if not frame.background:
                found.pop(BACKGROUND, None)  # the layer stays as it is
            return {name: image.cpu().numpy() for name, image in found.items()}, history

    def denoise(self, frame: Prepared, history: Any, ahead: tuple = ()) -> tuple[dict[str, np.ndarray], Any]:
        return self.step(frame, history)

    def save(self, history: Any) -> dict[str, np.ndarray]:
        return self._inner.save(history)

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        return self._inner.restore(fields)

    def remember(self, history: Any, frames: SequenceOf[Prepared]) -> Any:
        return self._inner.remember(history, [prepared.frame for prepared in frames])


def split(images: dict[str, Tensor], passes: LightPasses, each: bool) -> tuple[Parts, tuple[str, ...]]:
    """The parts to denoise, from the passes of a frame `[1, 3, H, W]` by name, and the names of their outputs. `each`:
    an output for every pass, else one for their sum."""
    import torch

    from ..models.parts import ALBEDO, Output, Parts

    radiance = {name: images[name] * images[lobe] for name in passes.lights if (lobe := name.split()[0]) != OWN_COLOR}
    own = [name for name in passes.lights if name not in radiance]
    lights: dict[str, tuple[Tensor, int | None]] = {}
    passed: dict[str, Tensor] = {}
    outputs: dict[str, Output] = {}
    if each:
        passed = {name: images[name] for name in (*passes.colors, *passes.passed)}
        color = list(passed).index(OWN_COLOR) if own else None
        lights = {
            name: (radiance[name], ALBEDO) if name in radiance else (images[name], color) for name in passes.lights
        }
        lights |= {name: (images[name], None) for name in passes.volumes}
        outputs = {name: Output(lights=(i,)) for i, name in enumerate(lights)}
        outputs |= {name: Output(passed=(i,)) for i, name in enumerate(passed)}
    elif passes.lights:
        passed = {OWN_COLOR: images[OWN_COLOR], "rest": _sum(images[name] for name in passes.passed)}
        lights = {"own": (_sum(images[name] for name in own), 0), "other": (_sum(radiance.values()), ALBEDO)}
        if passes.volumes:
            lights["volume"] = (_sum(images[name] for name in passes.volumes), None)
        outputs = {PICTURE: Output(tuple(range(len(lights))), (1,))}
    outputs |= {name: Output(lights=(len(lights) + i,)) for i, name in enumerate(passes.also)}
    lights |= {f"also {name}": (images[name], ALBEDO) for name in passes.also}
    light, colors = zip(*lights.values(), strict=True)
    nothing = light[0][:, :0]
    parts = Parts(torch.cat(light, 1), torch.cat([nothing, *passed.values()], 1), colors, tuple(outputs.values()))
    return parts, tuple(outputs)


def _compare_sum(frame: Frame, images: dict[str, Tensor], passes: LightPasses) -> tuple[float, bool]:
    """How far the passes are from the picture, as a share of its mean, and whether they come nearer to it with the
    background than without."""
    total = _sum(images[n] * images[n.split()[0]] if n in passes.lights else images[n] for n in passes.summands)
    mean = frame.radiance.mean().clamp(min=1e-12)
    whole, bare = (((x - frame.radiance).abs().mean() / mean).item() for x in (total, total - images[BACKGROUND]))
    return min(whole, bare), whole <= bare


def _check_sum(frame: Frame, apart: float, passes: LightPasses) -> None:
    """Raise InputError where the passes do not add up to the picture."""
    if apart > MAX_APART:
        advice = "" if passes.volumes else "are there volumes? switch on View Layer > Passes > Light > Volume, or "
        raise InputError(f"{frame.name}: --lights: the light passes do not add up to the picture, {100 * apart:.0f} % "
                         f"is missing or too much; {advice}leave --lights out")  # fmt: skip


def _check_sign(frame: str, name: str, image: Tensor) -> None:
    """Raise InputError for a layer that is no light: much of it is negative."""
    finite = image.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
    if (share := (finite.clamp(max=0).mean() / -finite.abs().mean()).item()) > MAX_NEGATIVE:  # black: NaN
        raise InputError(f"{frame}: --also {name}: {100 * share:.0f} % of it is negative, and light never is: leave it "
                         "out")  # fmt: skip


def _whole_groups(frame: Frame, images: dict[str, Tensor], passes: LightPasses) -> tuple[str, ...]:
    """The light groups, if they add up to the picture; else none."""
    groups = tuple(name for name in passes.also if name.startswith(GROUP))
    apart = (sum(images[name] for name in groups) - frame.radiance).abs().mean()
    return groups if groups and apart <= MAX_APART * frame.radiance.mean() else ()


def _shared_out(picture: Tensor, groups: dict[str, Tensor]) -> dict[str, Tensor]:
    """The groups, scaled so that they add up to the picture: the sum of denoised passes is not quite that of groups."""
    import torch

    total = sum(groups.values())
    return {name: torch.where(total > 0, x / total, 1 / len(groups)) * picture for name, x in groups.items()}


def _sum(images) -> Tensor:
    first, *others = images
    return sum(others, first)


def _valid(image: Tensor) -> Tensor:
    """Finite and not negative, as `sanitise` makes radiance."""
    import torch

    return torch.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).clamp(min=0)
