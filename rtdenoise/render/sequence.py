"""One sequence on disk: a numbered EXR file a frame, cameras and transforms in `scene.json`."""

from __future__ import annotations

import json
from pathlib import Path

from ..errors import InputError
from ..files import lock, read_json, remove_unfinished, write_atomically
from .frames import LAYERS, RenderOptions, describe_frame, render_frame
from .metropolis import chains_of, describe, unseen_lamps
from .scenes.scene import Scene
from .stage import Stage


def write_scene_json(
    scene: Scene, path: Path, numbers: range, size: tuple[int, int], render: dict | None = None
) -> None:
    """Add cameras and transforms of these frames, and of one frame before and after them, to the file.

    `render` describes how the frames are rendered, where that is not by path tracing. Raises InputError where the file
    describes another scene, size, motion or way to render.
    """
    frames = [describe_frame(scene, n, size) for n in range(numbers[0] - 1, numbers[-1] + 2)]
    document = {
        "format": "rtdenoise-scene-1",
        "width": size[1],
        "height": size[0],
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
    } | ({"render": render} if render else {})
    if path.exists():
        document["frames"] = _joined(path, read_json(path), document)
    write_atomically(path, json.dumps(document).encode())


def _joined(path: Path, before: dict, now: dict) -> list[dict]:
    """The frames of both documents, in order."""
    entries = {entry["number"]: entry for entry in now["frames"]}
    if isinstance(before, dict) and (found := before.get("render")) != (wanted := now.get("render")):
        raise InputError(f"{path}: the frames there were rendered with {_told(found)}, expected {_told(wanted)}; "
                         "choose another --out, or the options of that run")  # fmt: skip
    try:
        kept = {entry["number"]: entry for entry in before["frames"]}
        same = all(before[key] == now[key] for key in now if key != "frames")
    except (KeyError, TypeError):
        raise InputError(f"{path}: damaged: not as `rtdenoise render` writes it; remove it, or choose another "
                         "--out") from None  # fmt: skip
    if not same or any(entries[number] != kept[number] for number in entries.keys() & kept.keys()):
        raise InputError(f"{path}: is of another scene, motion or size, expected this one; choose another --out")
    return [entry for _, entry in sorted((kept | entries).items())]


def _told(render: object) -> str:
    """The options of Metropolis sampling in one line."""
    if not isinstance(render, dict):
        return "path tracing"
    return ", ".join(f"{key} = {value}" for key, value in render.items())


def render_sequence(
    scene: Scene, out: str | Path, frames: int, options: RenderOptions, first: int = 0, progress=print
) -> list[Path]:
    """Render frames first … first + frames − 1 to OUT/frame.NNNN.exr, with `scene.json` beside them.

    Existing frames are kept, so an interrupted run continues where it stopped.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out)
        return _render(scene, out, range(first, first + frames), options, progress)


def _render(scene: Scene, out: Path, numbers: range, options: RenderOptions, progress) -> list[Path]:
    from ..data.exr import write_layers

    write_scene_json(scene, out / "scene.json", numbers, options.size, _described(options))
    paths = {n: out / f"frame.{n:04d}.exr" for n in numbers}
    missing = [n for n in numbers if not paths[n].exists()]
    stage = Stage(scene) if missing else None
    if stage and options.metropolis and (warning := unseen_lamps(stage)):
        progress(f"warning: {warning}")
    for n in missing:
        layers = render_frame(stage, n, options)
        write_layers(paths[n], {k: layers[k] for k in LAYERS if k in layers})
        progress(f"{paths[n]}")
    return list(paths.values())


def _described(options: RenderOptions) -> dict | None:
    if options.metropolis is None:
        return None
    chains = chains_of(options.metropolis, options.size, options.spp)
    shared = {"spp": options.spp, "reference_spp": options.reference_spp, "max_depth": options.max_depth}
    return describe(options.metropolis) | shared | {"chains": chains, "noise": options.seed}
