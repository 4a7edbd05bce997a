"""What a fuzzer feeds: one function for each kind of file, which reads any bytes or refuses them in one line.

A target raises for everything else: another exception than InputError, a message of several lines or of thousands of
characters, values that are not finite, files outside the folder. tests/corpus/KIND holds small inputs that reach far
into each reader; tools/fuzz.py mutates them under atheris, and the tests replay them.

Safetensors files are given as their JSON header, a zero byte and the data, so that a mutated header keeps its length.
"""

from __future__ import annotations

import functools
import json
import random
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from synthetic import make_frames, save_tiny, write_clips, write_sequence

from rtdenoise.data.clip_file import read_facts, read_layers
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate import run as evaluate
from rtdenoise.evaluate.document import NAME, Document
from rtdenoise.models.weights import read_model
from rtdenoise.run import denoise as run
from rtdenoise.run.following import Following
from rtdenoise.run.torch_backend import TorchBackend

FINGERPRINT = "0" * 64
LONGEST_MESSAGE = 2000  # characters
CORPUS = Path(__file__).parent / "corpus"


@functools.cache
def folder() -> Path:
    """Scratch, in memory where the system has a place for that."""
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    _scratch.append(tempfile.TemporaryDirectory(prefix="rtdenoise-fuzz-", dir=place))
    return Path(_scratch[0].name)


_scratch: list[tempfile.TemporaryDirectory] = []


def refused(read: Callable[[], object]) -> bool:
    """Whether this raises InputError, of one line."""
    try:
        read()
    except InputError as error:
        line = str(error)
        assert line and "\n" not in line and len(line) <= LONGEST_MESSAGE, line[:200]
        return True
    return False


def safetensors(data: bytes) -> bytes:
    """The file whose header and content stand in `data`."""
    header, _, content = data.partition(b"\0")
    return struct.pack("<Q", len(header)) + header + content


def unpacked(file: bytes) -> bytes:
    """The inverse of `safetensors`."""
    length = struct.unpack("<Q", file[:8])[0]
    return file[8 : 8 + length].rstrip() + b"\0" + file[8 + length :]


def exr(data: bytes) -> None:
    path = folder() / "exr" / "frame.0001.exr"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    refused(lambda: read_channels(path, list(read_header(path).channels)))
    refused(lambda: open_sequence(path)[0])


def layout(data: bytes) -> None:
    path, shot = folder() / "layout.toml", _shot()
    path.write_bytes(data)
    refused(lambda: open_sequence(shot, preset=str(path))[0])


def scene(data: bytes) -> None:
    shot = _positions()
    (shot / "scene.json").write_bytes(data)
    refused(lambda: open_sequence(shot)[1])


def state(data: bytes) -> None:
    """A saved history, and a frame denoised with it."""
    sequence, options, backend, out, _ = _resumable()
    fingerprints = [FINGERPRINT] * (len(sequence) + 1)  # a real one depends on the time
    (out / run.STATE).write_bytes(safetensors(data))

    def resume():
        done, history, _ = run._resume(out, sequence, fingerprints, backend, options)
        if done < len(sequence):
            frame = sequence.read(done)
            image, _ = backend.step(backend.prepare(frame), history)
            run.write_frame(out / "later", sequence, done, frame, image)
            _check_finite(out / "later" / sequence.names[done])

    refused(resume)


def weights(data: bytes) -> None:
    """A model, and a frame denoised with it."""
    path, out = folder() / "weights.safetensors", folder() / "denoised"
    path.write_bytes(safetensors(data))
    if refused(lambda: read_model(path)):
        return
    options = run.Options(model=str(path), plan=False)
    if not refused(lambda: run.denoise(str(_shot() / "frame.0000.exr"), out, options, overwrite=True)):
        _check_finite(out / "frame.0000.exr")


def clip(data: bytes) -> None:
    place = folder() / "clips"
    place.mkdir(exist_ok=True)
    path = place / "clip_000000.safetensors"
    path.write_bytes(safetensors(data))
    refused(lambda: read_facts(path))
    refused(lambda: read_layers(path))
    refused(lambda: ClipDataset(place).scenes())
    refused(lambda: ClipDataset(place).load(0))
    refused(lambda: ClipDataset(place).load(0, signal="indirect", size=4))


def evaluation(data: bytes) -> None:
    place = folder() / "evaluation"
    place.mkdir(exist_ok=True)
    (place / NAME).write_bytes(data)
    refused(lambda: Document.read(place))


JSON_KINDS, SAFETENSORS_KINDS = ("scene", "evaluation"), ("state", "weights", "clip")
TARGETS = {f.__name__: f for f in (exr, layout, scene, state, weights, clip, evaluation)}


def _check_finite(path: Path) -> None:
    image = np.stack(list(read_channels(path, ("R", "G", "B")).values()))
    assert np.isfinite(image).all()


@functools.cache
def _shot() -> Path:
    return write_sequence(folder() / "shot", make_frames(3, H=8, W=8))


@functools.cache
def _positions() -> Path:
    """Frames whose motion has to be computed from scene.json."""
    place = folder() / "positions"
    place.mkdir()
    image = np.ones((9, 7, 3), np.float32)
    for number in range(3):
        write_layers(place / f"{number}.exr", {"color": image, "position": image, "id": image[..., :1]})
    return place


@functools.cache
def _model() -> Path:
    return save_tiny(folder())


@functools.cache
def _resumable() -> tuple:
    """A sequence of three frames of which two are done."""
    options, out = run.Options(model=str(_model()), lookahead=0), folder() / "out"

    class Stop(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise Stop

    try:
        run.denoise(str(_shot()), out, options, on_frame=stop)
    except Stop:
        (out / "later").mkdir()
    sequence, seed = open_sequence(_shot()), unpacked((out / run.STATE).read_bytes())
    seed = seed.replace(run.digest(sequence, options)[2].encode(), FINGERPRINT.encode())
    return sequence, options, Following(TorchBackend(options.model, "cpu", "auto"), True), out, seed


ODD = (None, True, False, 0, 1, -1, 2, 2**31, 2**63, -(2**63), 10**400, 0.5, -0.0, 1e30, 1e308, "", "x", "1", "\n",
       "\0", "../../x", "a" * 3000, [], [[]], {}, {"x": 1}, [1], [1] * 300, "F32", "I32", "BF16", "F64")  # fmt: skip


def mutated_json(text: bytes, seed: int) -> bytes:
    """JSON with one value replaced by an odd one, left out or repeated; the same bytes where they are not JSON."""
    rng = random.Random(seed)
    try:
        document = json.loads(text)
        return json.dumps(_mutated(document, rng)).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        return text


def _mutated(value: object, rng: random.Random) -> object:
    if isinstance(value, str) and value[:1] in ("{", "["):  # JSON inside JSON, as in the headers of safetensors
        return mutated_json(value.encode("utf-8", "surrogatepass"), rng.getrandbits(32)).decode("utf-8", "replace")
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return rng.choice(ODD)
    copy = value.copy()
    key = rng.choice(list(value)) if isinstance(value, dict) else rng.randrange(len(value))
    what = rng.random()
    if what < 0.1:
        del copy[key]
    elif what < 0.15 and isinstance(copy, list):
        copy.insert(key, copy[key])
    elif what < 0.2 and isinstance(copy, dict):
        copy[str(rng.choice(ODD))[:50]] = copy.pop(key)
    else:
        copy[key] = _mutated(copy[key], rng)
    return copy


def seeds(kind: str) -> list[bytes]:
    """Small valid inputs of a kind, to begin with."""
    if kind == "exr":
        image = np.random.default_rng(0).random((3, 4, 3), np.float32)
        made = []
        for compression in ("none", "zip", "rle", "piz"):
            path = folder() / f"{compression}.exr"
            write_layers(path, {"color": image, "depth": image[..., :1]}, compression=compression)
            made.append(path.read_bytes())
        import OpenEXR

        plane = image[..., 0].copy()
        parts = [OpenEXR.Part({}, {"RGB": image}, "V.Combined"), OpenEXR.Part({}, {"Z": plane}, "V.Depth")]
        OpenEXR.File(parts).write(str(folder() / "parts.exr"))
        return [*made, (folder() / "parts.exr").read_bytes()]
    if kind == "layout":
        return [LAYOUT.encode(), FILES.encode()]
    if kind == "scene":
        camera = {"world_to_pixel": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "camera_origin": [0, 0, 0]}
        camera["world_to_pixel"].insert(2, [0, 0, 0, 1])
        frames = [
            {"number": n, "shot": 0, "object_to_world": {"1": np.eye(4).tolist()}, **camera} for n in range(-1, 4)
        ]
        return [json.dumps({"format": "rtdenoise-scene-1", "width": 7, "height": 9, "objects": {"1": "wall"},
                            "frames": frames}).encode()]  # fmt: skip
    if kind == "state":
        return [_resumable()[-1]]
    if kind == "weights":
        return [unpacked(_model().read_bytes())]
    if kind == "clip":
        (path,) = write_clips(folder() / "written", [0], size=4).iterdir()
        return [unpacked(path.read_bytes())]
    options = evaluate.EvaluateOptions(methods=("noisy",), metrics=("psnr",), spp=(1, 2))
    evaluate.run([_shot()], folder() / "measured", options)
    return [(folder() / "measured" / NAME).read_bytes()]


LAYOUT = """name = "tracer"
demodulated = ["indirect"]
[color]
channels = ["R", "G", "B"]
[albedo]
channels = ["albedo.R", "albedo.G", "albedo.B"]
[depth]
channels = ["depth.Z"]
miss = 1e10
[motion]
channels = ["motion.X", "motion.Y"]
signs = [1, -1]
scale = "uv"
"""
FILES = """[color]
channels = ["R", "G", "B"]
file = "frame.{frame}.exr"
[albedo]
channels = ["albedo.R", "albedo.G", "albedo.B"]
file = "frame.{frame}.exr"
"""
