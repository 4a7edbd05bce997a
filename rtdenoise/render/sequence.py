"""One sequence on disk: a numbered EXR file a frame; cameras, transforms and the options of rendering in `scene.json`.

A folder holds frames of one scene and one choice of options: a run that would add others is refused.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from ..errors import InputError
from ..files import lock, read_bytes, read_json, remove_unfinished, write_atomically
from .frames import LAYERS, RenderOptions, describe_frame, render_frame
from .metropolis import unseen_lamps
from .scenes.scene import Scene
from .stage import Stage

REMEDY = "choose another --out or the options of that run"


def write_scene_json(scene: Scene, path: Path, numbers: range, options: RenderOptions, begun: bool) -> None:
    """Add cameras and transforms of these frames, and of one frame before and after them, to the file. `begun`: the
    folder holds frames already, so its options must be these.

    Raises InputError where the file describes another scene, size or motion, or frames of other options.
    """
    frames = [describe_frame(scene, n, options.size) for n in range(numbers[0] - 1, numbers[-1] + 2)]
    document = {
        "format": "rtdenoise-scene-1",
        "width": options.size[1],
        "height": options.size[0],
        "objects": {str(o.id): o.name for o in scene.objects},
        "frames": [
            {
                "number": f["number"],
                "world_to_pixel": f["world_to_pixel"].tolist(),
                "camera_origin": f["camera_origin"].tolist(),
                "shot": f["shot"],
                "object_to_world": {str(k): m.tolist() for k, m in f["object_to_world"].items()},
            }
            for f in frames
        ],
        "rendered": rendered_with(scene, options),
    }
    if path.exists():
        before = read_json(path)
        if begun:
            _refuse_other_options(path, before, document)
        document["frames"] = _joined(path, before, document)
    write_atomically(path, json.dumps(document).encode())


def rendered_with(scene: Scene, options: RenderOptions) -> dict[str, object]:
    """What the pixels of every frame depend on beside cameras, transforms and size, by the names of the options; as
    JSON reads it back."""
    name = scene.name
    if scene.file:
        name = f"{Path(scene.file).name} with SHA-256 {hashlib.sha256(read_bytes(Path(scene.file))).hexdigest()[:12]}"
    chosen = {key.replace("_", "-"): value for key, value in asdict(options).items() if key != "size"}
    textures = scene.facts.get("pictures", {}).get("folder")
    lit = f"{name}, with a sun" if scene.sun else name
    return json.loads(json.dumps({"scene": lit, "textures": textures} | chosen))


def _refuse_other_options(path: Path, before: object, now: dict) -> None:
    """Raise InputError where frames beside the file were rendered with another value of an option; it names them."""
    if not isinstance(before, dict) or not isinstance(before.get("rendered"), dict):
        raise InputError(f"{path}: damaged: not as `rtdenoise render` writes it; remove it, or choose another --out")
    pairs = {name: (before.get(name), now[name]) for name in ("width", "height")}
    pairs |= {name: (before["rendered"].get(name), value) for name, value in now["rendered"].items()}
    if changed := {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}:
        told = ", ".join(f"{name} {before}, now {now}" for name, (before, now) in changed.items())
        raise InputError(f"{path.parent}: holds frames rendered with other options: {told}; {REMEDY}")


def _joined(path: Path, before: dict, now: dict) -> list[dict]:
    """The frames of both documents, in order."""
    entries = {entry["number"]: entry for entry in now["frames"]}
    try:
        kept = {entry["number"]: entry for entry in before["frames"]}
        joined = sorted(kept.keys() | entries.keys())
        same = all(before[key] == now[key] for key in ("format", "width", "height", "objects"))
    except (KeyError, TypeError):
        raise InputError(f"{path}: damaged: not as `rtdenoise render` writes it; remove it, or choose another "
                         "--out") from None  # fmt: skip
    if not same or any(entries[number] != kept[number] for number in entries.keys() & kept.keys()):
        raise InputError(f"{path}: is of another scene, motion or size, expected this one; choose another --out")
    return [(kept | entries)[number] for number in joined]


def render_sequence(
    scene: Scene, out: str | Path, frames: int, options: RenderOptions, first: int = 0, progress=print
) -> list[Path]:
    """Render frames first … first + frames − 1 to OUT/frame.NNNN.exr, with `scene.json` beside them.

    Existing frames are kept, so an interrupted run continues where it stopped. Raises InputError where they are
    damaged, or of another scene or other options.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out)
        return _render(scene, out, range(first, first + frames), options, progress)


def _render(scene: Scene, out: Path, numbers: range, options: RenderOptions, progress) -> list[Path]:
    from ..data.exr import write_layers

    paths = {n: out / f"frame.{n:04d}.exr" for n in numbers}
    write_scene_json(scene, out / "scene.json", numbers, options, begun=any(out.glob("frame.*.exr")))
    missing = [n for n in numbers if not paths[n].exists()]
    for n in sorted(set(numbers) - set(missing)):
        _refuse_foreign(paths[n], options.size)
    stage = Stage(scene) if missing else None
    if stage and options.metropolis and (warning := unseen_lamps(stage)):
        progress(f"warning: {warning}")
    for n in missing:
        layers = render_frame(stage, n, options)
        write_layers(paths[n], {k: layers[k] for k in LAYERS if k in layers})
        progress(f"{paths[n]}")
    return list(paths.values())


def _refuse_foreign(path: Path, size: tuple[int, int]) -> None:
    """Raise InputError where a frame that is kept is damaged or of another size (height, width)."""
    from ..data.exr import read_header

    header = read_header(path)
    if (header.height, header.width) != size:
        raise InputError(f"{path}: is {header.width}×{header.height}, expected {size[1]}×{size[0]}; {REMEDY}")
