"""The options of `denoise` and `combine`. Needs no torch."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal

from ..errors import InputError

AUTO = "auto"
EXAMINED = 3  # frames that the plan examines
MAX_LOOKAHEAD = 16  # frames; beyond 8 little is gained
AHEAD = 6  # frames, with 'auto' (docs/notes/lookahead.md)
MANY_AHEAD = 3  # likewise of many samples a pixel
FEW_AHEAD = 2  # likewise of light in parts, whose frames are larger
MAX_SAMPLES = 1_000_000  # a pixel; more is a slip
MAX_SHUTTER = 100.0  # frames; more is a slip
POSITIONS = {"start": 0.5, "center": 0.0, "end": -0.5}  # middle of the time that a shutter is open / that time
MIXED = 8  # samples a pixel from which paths are means of what a pane reflects and shows (docs/notes/virtual_motion.md)


@dataclass(frozen=True)
class Options:
    """The options of `denoise`."""

    signal: str = "color"
    """The signal to denoise: 'color' (the beauty) or 'indirect'."""
    model: str = AUTO
    """The network: 'hybrid', 'hybrid-many', 'hybrid-fast', 'hybrid-large', 'hybrid-large-many', 'default', 'many',
    'fast', 'paper', or a .safetensors file that `rtdenoise train` wrote. 'auto': 'hybrid', and from 4 samples a pixel
    on, where their number is known or noise is little, 'hybrid-large-many'; 'hybrid-many' with --lookahead 0, and with
    --offline but for frames of Cycles. 'hybrid-large' where the first frame of Cycles shows much water or glass. With
    glsl and --correct 'default' and 'many', which take less than half of the time."""
    preset: str = "auto"
    """Layout of the input: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', 'noisebase', or a .toml
    file."""
    layout: str = "plain"
    """Channels of the output files: 'plain' (the result in R,G,B) or 'source' (a copy of the input with the result in
    its place)."""
    recombine: bool = False
    """Add the rest of the light to the denoised signal: the result is the beauty."""
    lights: bool = False
    """With --layout source: denoise every light pass that Blender's Cycles split, each as a picture of its own; the
    picture is their sum."""
    also: tuple[str, ...] = ()
    """Additive layers (light groups, AOVs) to denoise beside the picture, by name."""
    keep: tuple[str, ...] = ()
    """Layers of the input to copy into the output ('albedo', 'depth' ...), or 'all'."""
    float32: bool = False
    """Write 32-bit float instead of 16-bit half, as always where a frame is too bright for half."""
    alpha: str = "auto"
    """The picture's alpha: 'auto' gives that of fewer than 8 samples a pixel the denoised picture's edges, and denoises
    shadows on a shadow catcher as light; 'rendered' leaves it."""
    allow_gaps: bool = False
    """Accept missing frame numbers; history starts anew after each gap."""
    detect_cuts: bool = True
    """Start history anew where most pixels find another surface than their motion vectors promise."""
    detect_exposure: bool = True
    """Find out how much brighter or darker the picture as a whole becomes from frame to frame, as by a fade or an
    animated exposure, and make history as bright; each light of --lights and --also for itself."""
    virtual_motion: bool = True
    """Follow what is seen in flat mirrors and through panes, where files tell how far away it is, as those of Cycles do
    with Denoising Data: motion vectors are those of mirror and pane."""
    fog: bool = True
    """Give pixels whose sample is scattered in fog the surface and the motion of what is behind, where files tell which
    they are, as those of Cycles do with the Volume passes."""
    motion_blur: bool = False
    """Blur what moves in the denoised picture as a shutter would: for frames that were rendered without motion blur."""
    surfaces: str = ""
    """For frames that were rendered with motion blur: a second render without it (folder or glob). Albedo, normal,
    depth and motion are taken from there; what moves is blurred in albedo and normal as the shutter blurs it. With
    several shots the folder that holds a folder of each shot's name."""
    shutter: float = 0.5
    """With --motion-blur or --surfaces: frames that the shutter is open, Blender's Shutter."""
    shutter_position: Literal["start", "center", "end"] = "center"
    """With --motion-blur or --surfaces: where a frame's time lies in the time that the shutter is open, Blender's
    Position."""
    lens: bool = False
    """Add the zoom or shift of the picture that motion vectors lack, from frame to frame, found by albedo: those of
    Cycles lack a camera shift, and before Blender 4.5 an animated focal length."""
    detect_lens: bool = True
    """Find out whether frames of Cycles need --lens, by one pair of frames in 16."""
    detect_panorama: bool = True
    """Find out whether frames are panoramas, whose left and right edges meet: twice as wide as high, with the same
    surfaces at both, and all of them facing a camera that looks around."""
    plan: bool = True
    """Leave out work that a frame does not need (`rtdenoise inspect` lists it); off: everything runs."""
    backend: str = "auto"
    """'torch', 'glsl' (OpenGL compute shaders, needs no PyTorch), or 'auto': torch where it is installed."""
    device: str = "auto"
    """Device of the torch backend: 'auto', 'cpu' or 'cuda'."""
    offline: bool = False
    """The best picture for frames on disk: uses the frames after as well as those before, and OIDN or networks
    like its own. Takes 25 to 45 times as long as without. With --lights and --also it serves
    the picture; its lights look two frames ahead."""
    lookahead: int | Literal["auto"] = AUTO
    """Denoise each frame with so many of those after it. 'auto': with the networks that write pixels (hybrid and its
    kind) in torch 6, or 3 with those for many samples a pixel, or 2 with --lights and --also; 0 with others. From 3
    on the last of them counts through the picture of the next frame, which is mixed in."""
    correct: bool = False
    """Correct every frame by what the noisy frames before it agree on: for 4 samples a pixel and more."""
    samples: int = 0
    """Samples a pixel of the frames, where the files do not say (those of Cycles do): the model 'auto' and --correct go
    by them."""
    confidence: bool = False
    """With --offline: also write how far the candidates lie apart, in radiance, as the layer 'confidence' (small is
    sure)."""
    precision: str = "auto"
    """Precision of the network: 'fp32', 'bf16' (torch), 'int8' (for CPUs that multiply bytes), 'fp16' (glsl, for
    stored activations), or 'auto' (torch: bf16 or int8 where the hardware is faster with it, fp32 with
    --offline; glsl: fp32)."""


@dataclass(frozen=True)
class CombineOptions:
    """The options of `combine`."""

    signal: str = "color"
    """The denoised signal: 'color' (the beauty) or 'indirect'."""
    model: str = "combiner"
    """The combiner: 'combiner', 'shrinkage', which has no network, or a .safetensors file that `rtdenoise train`
    wrote."""
    second: str = ""
    """A second render of the noisy frames (folder or glob) with another seed and as many samples: both are used, and
    their differences tell noise from light."""
    samples: int = 0
    """Samples a pixel of each noisy frame, where the files do not say. From 4 on edges are corrected, too."""
    preset: str = "auto"
    """Layout of the noisy files: as for denoise."""
    layout: str = "plain"
    """Channels of the output files: 'plain' (the result in R,G,B) or 'source' (a copy of the noisy file with the result
    in its place)."""
    recombine: bool = False
    """Add the rest of the light to the corrected signal: the result is the beauty."""
    keep: tuple[str, ...] = ()
    """Layers of the noisy files to copy into the output ('albedo', 'depth' ...), or 'all'."""
    float32: bool = False
    """Write 32-bit float instead of 16-bit half, as always where a frame is too bright for half."""
    alpha: str = "auto"
    """The picture's alpha: as for denoise."""
    confidence: bool = False
    """Also write the size of each pixel's correction, in radiance, as the layer 'confidence'."""
    allow_gaps: bool = False
    """Accept missing frame numbers; no frame is corrected by frames beyond a gap."""
    detect_cuts: bool = True
    """Use no frames beyond one where most pixels show another surface than their motion vectors promise."""
    surfaces: str = ""
    """A second render of frames that have motion blur, without it: as for denoise."""
    shutter: float = 0.5
    """With --surfaces: frames that the shutter is open."""
    shutter_position: Literal["start", "center", "end"] = "center"
    """With --surfaces: where a frame's time lies in the time that the shutter is open."""
    lens: bool = False
    """Add the zoom or shift of the picture that motion vectors lack: as for denoise."""
    detect_lens: bool = True
    """Find out whether frames of Cycles need --lens: as for denoise."""
    detect_panorama: bool = True
    """Find out whether frames are panoramas, whose left and right edges meet: as for denoise."""
    device: str = "auto"
    """'auto', 'cpu' or 'cuda'."""
    precision: str = "auto"
    """Precision of the network: 'fp32', 'bf16', or 'auto' (bf16 where the hardware is faster with it)."""


def of_output(options: Options | CombineOptions) -> dict[str, Any]:
    """The options of `data.output.write_frame`."""
    chosen = {name: getattr(options, name) for name in ("layout", "recombine", "keep", "float32", "alpha")}
    blurs = isinstance(options, Options) and options.motion_blur
    return chosen | {"shutter": shutter_times(options) if blurs else None}


def shutter_times(options: Options | CombineOptions) -> tuple[float, float]:
    """When the shutter opens and closes, in frames from the time of the frame. Raises InputError for a shutter that
    there is not."""
    if not 0 < options.shutter <= MAX_SHUTTER:
        raise InputError(f"--shutter: expected more than 0 and up to {MAX_SHUTTER:g} frames, got {options.shutter:g}")
    if options.shutter_position not in POSITIONS:
        raise InputError(f"--shutter-position: expected {', '.join(POSITIONS)}, got {options.shutter_position}")
    middle = options.shutter * POSITIONS[options.shutter_position]
    return middle - options.shutter / 2, middle + options.shutter / 2


def told_of_shutter(options: Options | CombineOptions) -> list[str]:
    """What there is to say of a shutter that nothing reads."""
    chosen = (options.shutter, options.shutter_position) != (Options.shutter, Options.shutter_position)
    if options.surfaces or not chosen or getattr(options, "motion_blur", False):
        return []
    readers = "--motion-blur or --surfaces" if isinstance(options, Options) else "--surfaces"
    return [f"--shutter, --shutter-position: change nothing without {readers}"]


def check_lookahead(frames: int | str, told: str = "--lookahead") -> None:
    """Raise InputError for a number of frames to look ahead that is out of range."""
    whole = isinstance(frames, Integral) and not isinstance(frames, bool)
    if not (whole and 0 <= frames <= MAX_LOOKAHEAD):
        raise InputError(f"{told}: expected 0 to {MAX_LOOKAHEAD} frames, got {frames}")


def check_samples(samples: int, told: str = "--samples") -> None:
    """Raise InputError for a number of samples a pixel that no frame has; `told` names the option."""
    number = isinstance(samples, Real) and not isinstance(samples, bool)
    if not (number and 0 <= samples <= MAX_SAMPLES):
        raise InputError(f"{told}: expected 1 to {MAX_SAMPLES}, or 0 for unknown, got {samples!r}")
    if samples != int(samples):
        raise InputError(f"{told}: expected a whole number, got {samples!r}")


def check(options: Options) -> None:
    """Raise InputError for options of `denoise` that do not go together."""
    if options.correct and (options.offline or options.lights or options.also):
        raise InputError("--correct: goes without --offline, --lights and --also; `rtdenoise combine` corrects their "
                         "frames")  # fmt: skip
    check_samples(options.samples)
    if options.lookahead != AUTO:
        check_lookahead(options.lookahead)
    if options.offline and options.backend == "glsl":
        raise InputError("--offline: goes with --backend torch; the compute shaders run forward only")
    if options.lookahead != AUTO and options.offline:
        raise InputError("--lookahead: goes without --offline, which looks at all frames")
    if options.motion_blur and (options.signal != "color" or options.recombine or options.lights or options.also):
        raise InputError("--motion-blur: goes with --signal color, without --recombine, --lights and --also")
    if options.motion_blur and options.surfaces:
        raise InputError("--motion-blur: is for frames that were rendered without, --surfaces for frames that have it")
    if options.confidence and (not options.offline or options.lights or options.also):
        raise InputError("--confidence: goes with --offline, and without --lights and --also")
    if options.samples and not options.correct and options.model != AUTO:
        raise InputError(f"--samples {options.samples}: goes with --correct, or without --model")
