"""Everything an engine needs to denoise at one size, without this package: `rtdenoise export`.

- export.json: the dispatches of a first and of a following frame; docs/use/engines.md explains it
- weights.bin: packed as the shaders read them
- glsl/*.comp: every pass with everything included; spirv/*.spv: the same for Vulkan, where glslang is installed
- sample/: two frames and their results, to check a port with
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from .. import __version__
from ..errors import InputError
from ..files import LOCK, UNFINISHED, dumps, lock, remove_unfinished, write_atomically
from ..frame import RECENT
from .current import current
from .dispatch import Dispatch
from .pipeline import Pipeline
from .program import Program
from .record import BEFORE, Recording, Step, record
from .sample import sample_frames

FORMAT = 1
FRAMES = ("first", "following")
ALIGNMENT = 256  # bytes, of every array in weights.bin: the most that Vulkan asks for
PARTS = {"glsl", "spirv", "sample", "weights.bin"}  # what is written before export.json, the last
COMPILERS = ("glslangValidator", "glslang")
WORDS = {"int": (4, 4), "uint": (4, 4), "float": (4, 4), "vec2": (8, 8), "ivec2": (8, 8), "ivec3": (16, 12)}  # std430
TOLERANCE, HALF_TOLERANCE = 1e-3, 3e-2  # relative to |expected| + rms: other drivers round differently


@dataclass(frozen=True)
class Exported:
    """The outcome of an export."""

    shaders: int
    dispatches: int  # of a following frame
    weights: int  # bytes
    spirv: bool


def export(
    out: str | Path,  # a new or empty folder, or one that an interrupted export left
    model: str = "default",  # a shipped name or a .safetensors file
    size: tuple[int, int] = (720, 1280),  # of the frames, (H, W)
    half: bool = False,  # store activations as float16
    recent: int | None = None,  # frames that the history keeps, where not those of the model
) -> Exported:
    """Write the passes of a model.

    Raises InputError for an unknown model, a number of recent frames that it cannot keep, a folder that holds anything
    else or that another run writes to, a size that the device has no memory for, where there is no OpenGL 4.3, and
    where glslang rejects a shader.
    """
    out = Path(out)
    _refuse_other(out)
    if blocked := [path for path in out.parents if path.exists() and not path.is_dir()]:
        raise InputError(f"{out}: {blocked[0]} is not a folder; choose another --out")
    pipeline = Pipeline.load(model, half, **({} if recent is None else {"recent": recent}))
    first, following = sample_frames(size, len(FRAMES))
    recordings = record(pipeline, [replace(first, motion=None), following])
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        _refuse_other(out)  # another run may have ended meanwhile
        remove_unfinished(out, inside=True)
        done = _write(out, recordings, {"model": model, "width": size[1], "height": size[0],
                                        "tolerance": HALF_TOLERANCE if half else TOLERANCE})  # fmt: skip
        with contextlib.suppress(OSError):  # Windows keeps what is open
            (out / LOCK).unlink()  # an engine has no use for it; export.json refuses all further exports
        return done


def _refuse_other(out: Path) -> None:
    """Raise InputError for a folder that holds anything but what an interrupted export leaves."""
    ours = {*PARTS, LOCK}
    if out.exists() and not (
        out.is_dir() and all(path.name in ours or UNFINISHED.fullmatch(path.name) for path in out.iterdir())
    ):
        raise InputError(f"{out}: is not an empty folder; choose another --out")


def _write(out: Path, recordings: list[Recording], described: dict) -> Exported:
    """Write all files. `described`: what export.json says first."""
    for folder in ("glsl", "sample"):
        (out / folder).mkdir(exist_ok=True)
    shaders = _Shaders(out)
    passes = {
        name: [_dispatch(step, recording, shaders) for step in recording.steps]
        for name, recording in zip(FRAMES, recordings, strict=True)
    }
    spirv = shaders.compile()
    buffers, weights = _buffers(recordings)
    write_atomically(out / "weights.bin", weights)
    document = {
        "format": FORMAT, "rtdenoise": __version__, **described, "shaders": shaders.described(spirv),
        "buffers": buffers, "keep": _swaps(recordings[-1], buffers), "output": "result", "frames": passes,
        "sample": {name: _sample(out, name, r) for name, r in zip(FRAMES, recordings, strict=True)},
    }  # fmt: skip
    write_atomically(out / "export.json", (dumps(document, indent=1) + "\n").encode())
    return Exported(len(shaders.names), len(passes[FRAMES[-1]]), len(weights), spirv)


class _Shaders:
    """The specialised shaders of an export, each written once."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.names: dict[int, str] = {}  # id of a program -> name of its files
        self.programs: dict[str, Program] = {}

    def name(self, program: Program) -> str:
        """The name of a program's files, which are written on the first call."""
        if id(program) not in self.names:
            base = program.name.replace("/", "-")
            name = f"{base}-{1 + sum(other.name == program.name for other in self.programs.values())}"
            self.names[id(program)], self.programs[name] = name, program
            write_atomically(self.out / "glsl" / f"{name}.comp", program.source.text.encode())
        return self.names[id(program)]

    def compile(self) -> bool:
        """Compile all to SPIR-V. False where glslang is not installed."""
        compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
        if compiler is None:
            return False
        (self.out / "spirv").mkdir(exist_ok=True)
        for name in self.programs:
            source, target = self.out / "glsl" / f"{name}.comp", self.out / "spirv" / f"{name}.spv"
            command = [compiler, "-V", "-o", target, source]
            run = subprocess.run(command, capture_output=True, text=True, errors="replace")
            if run.returncode or not target.is_file():
                said = run.stdout.strip() or run.stderr.strip() or f"exit code {run.returncode}"
                raise InputError(f"{source}: {compiler} rejects it: {said}")
        return True

    def described(self, spirv: bool) -> dict[str, dict]:
        """The entry of each shader in export.json."""
        described = {}
        for name, program in self.programs.items():
            files = {"glsl": f"glsl/{name}.comp"} | ({"spirv": f"spirv/{name}.spv"} if spirv else {})
            described[name] = files | _interface(program)
        return described


def _interface(program: Program) -> dict:
    """Constants, bindings and parameters of a shader, with the offsets of the latter in Vulkan's push constants."""
    source, offset, parameters = program.source, 0, {}
    for name, kind in zip(source.parameters, source.types, strict=True):
        alignment, size = WORDS[kind]
        offset += -offset % alignment
        parameters[name] = {"type": kind, "offset": offset}
        offset += size
    access = zip(source.buffers, source.access, strict=True)
    return {
        "constants": dict(sorted(source.constants.items())),
        "buffers": [{"binding": i, "name": name, "access": kind} for i, (name, kind) in enumerate(access)],
        "parameters": parameters, "push_constant_bytes": offset,
    }  # fmt: skip


def _dispatch(step: Step, recording: Recording, shaders: _Shaders) -> dict:
    call: Dispatch = step.call
    return {
        "shader": shaders.name(call.program), "groups": call.groups,
        "buffers": {name: recording.name(array) for name, array in call.buffers.items()},
        "parameters": call.parameters, "checks": step.checks,
    }  # fmt: skip


def _buffers(recordings: list[Recording]) -> tuple[dict[str, dict], bytes]:
    """Name -> kind, type, shape and bytes of every buffer; and the content of those that hold weights."""
    found, weights = {}, bytearray()
    for recording in recordings:
        for step in recording.steps:
            for binding, array in step.call.buffers.items():
                name = recording.name(array)
                entry = {
                    "kind": _kind(binding, name, recording), "type": str(array.dtype), "shape": array.shape,
                    "bytes": array.buffer.size,
                }  # fmt: skip
                if name in found:
                    assert found[name]["bytes"] == entry["bytes"], name
                    continue
                if entry["kind"] == "weights":
                    weights += bytes(-len(weights) % ALIGNMENT)
                    entry["offset"] = len(weights)
                    with current(array.buffer.ctx):
                        weights += array.buffer.read()
                found[name] = entry
    return found, bytes(weights)


def _swaps(following: Recording, buffers: Mapping[str, dict]) -> dict[str, str]:
    """Pairs of buffers that change places after a frame, one after the other: what it wrote becomes the frame before's,
    and each recent frame the one before that."""
    read = [name for name in following.read if name + BEFORE in buffers]
    recent = [name + BEFORE for name in read if name.startswith(RECENT)]
    others = {name + BEFORE: name for name in read if not name.startswith(RECENT)}
    return others | dict(reversed([*pairwise([*recent, f"{RECENT}0"])]))


def _kind(binding: str, name: str, recording: Recording) -> str:
    if binding in ("weights", "biases"):
        return "weights"
    if name in recording.inputs:
        return "input"
    history = {*recording.written, *(known + BEFORE for known in recording.read)}
    return "history" if name in history else "scratch"


def _sample(out: Path, frame: str, recording: Recording) -> dict[str, str]:
    """Write the layers and the result of a sample frame; returns buffer -> file, and "result"."""
    arrays = {name: array.read() for name, array in recording.inputs.items()} | {"result": recording.image}
    files = {name: f"sample/{frame}-{name}.bin" for name in arrays}
    for name, array in arrays.items():
        write_atomically(out / files[name], array.tobytes())
    return files
