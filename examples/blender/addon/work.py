"""A job on disk: `FOLDER/SCENE/` with a copy of the .blend file, noisy frames, clean frames, and what was asked for.
With motion blur the surfaces without it, too.

The copy is rendered, not the file that is open: what is edited meanwhile changes nothing, and a cancelled job goes on
from the same copy.
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy

from .process import Stage, Trouble, is_writable, last_line

JOB, COPY, UNFINISHED = "job.json", "job.blend", "unfinished.exr"
RENDERER = Path(__file__).with_name("render_frames.py")


@dataclass(frozen=True)
class Work:
    """What was asked for."""

    scene: str
    view_layer: str
    samples: int
    first: int  # frame numbers
    last: int
    light: str  # "BEST" or "PASSES", see `Settings.light`
    also: tuple[str, ...]  # layers to denoise beside the picture
    folder: str
    noisy: str
    clean: str
    finished: bool = False
    lens: bool = False  # whether a camera's lens may move, which vectors of Cycles do not tell
    source: str = ""  # folder of the .blend file
    surfaces: str = ""  # folder of a second render, where there is motion blur
    shutter: float = 0.5  # frames that it is open then
    shutter_position: str = "center"

    @property
    def arguments(self) -> list[str]:
        """Of rtdenoise."""
        if self.light == "BEST":
            how = ["--offline"]
        else:
            how = ["--lights", "--lookahead", "2", *(("--also", *self.also) if self.also else ())]
        blur = ["--surfaces", self.surfaces, "--shutter", str(self.shutter), "--shutter-position",
                self.shutter_position] if self.surfaces else []  # fmt: skip
        return ["denoise", self.noisy, "--out", self.clean, "--preset", f"cycles:{self.view_layer}", "--layout",
                "source", "--progress", "lines", *(["--lens"] if self.lens else []), *blur, *how]  # fmt: skip


def folder_of(scene: bpy.types.Scene) -> Path:
    """The folder of the scene's job."""
    folder = Path(bpy.path.abspath(scene.rtdenoise.folder or "//"))
    return folder / (bpy.path.clean_name(scene.name) or "scene")


def read(folder: Path) -> Work | None:
    """The job in a folder; None where there is none that can be read."""
    try:
        stored = json.loads((folder / JOB).read_text(encoding="utf-8"))
        return Work(**stored | {"also": tuple(stored["also"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def can_go_on(folder: Path) -> bool:
    """Whether the folder holds a job that was cancelled or failed."""
    work = read(folder)
    return work is not None and not work.finished and (folder / COPY).is_file()


def begin(context: bpy.types.Context) -> Work:
    """Start anew: write the job and a copy of the .blend file, and remove the frames of the job before.

    Raises Trouble where the folder cannot be written to, or holds files of someone else.
    """
    scene, settings, folder = context.scene, context.scene.rtdenoise, folder_of(context.scene)
    render = scene.render
    if reason := is_writable(folder):
        raise Trouble(f"{folder} cannot be written to ({reason}): choose another folder under Denoise Animation")
    work = Work(
        scene.name, context.view_layer.name, settings.samples, scene.frame_start, scene.frame_end, settings.light,
        also_of(settings.also, additive(context.view_layer)), str(folder), str(folder / "noisy"), str(folder / "clean"),
        lens=any(item.type == "CAMERA" and item.data.animation_data is not None for item in scene.objects),
        source=str(Path(bpy.data.filepath).parent), surfaces=str(folder / "surfaces") if blurs(context) else "",
        shutter=render.motion_blur_shutter, shutter_position=render.motion_blur_position.lower(),
    )  # fmt: skip
    parts = Path(work.noisy), folder / "surfaces", Path(work.clean)
    if not (folder / JOB).exists() and any(part.exists() and any(part.iterdir()) for part in parts):
        raise Trouble(f"{folder} holds frames of something else: choose another folder under Denoise Animation")
    remove_frames(*parts)
    remove_leftovers(work)
    write(work)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / COPY), copy=True, relative_remap=True, compress=True)
    share_cache(Path(bpy.data.filepath), folder / COPY)
    return work


def additive(layer: bpy.types.ViewLayer) -> set[str]:
    """The names of a view layer's passes of light groups, of its own, and of shadows on a catcher."""
    groups = {f"Combined_{group.name}" for group in layer.lightgroups}
    return groups | {aov.name for aov in layer.aovs} | {"Shadow Catcher"}


def also_of(text: str, known: set[str]) -> tuple[str, ...]:
    """Names of passes between commas or spaces; one of `known` may hold spaces itself, between commas."""
    parts = [" ".join(part.split()) for part in text.split(",")]
    return tuple(name for part in parts for name in ([part] if part in known else part.split()))


def remove_frames(*folders: Path) -> None:
    """Remove the frames of a job, and what rtdenoise keeps beside them until it is done."""
    for folder in folders:
        for path in [*folder.glob("frame.*.exr"), *folder.glob(".rtdenoise*"), *folder.glob("denoise.json")]:
            if path.is_dir() and not path.is_symlink():  # a cancelled --offline had a first pass there
                shutil.rmtree(path)
            else:
                path.unlink()


def blurs(context: bpy.types.Context) -> bool:
    """Whether the frames get motion blur."""
    render, layer = context.scene.render, context.view_layer
    return render.use_motion_blur and render.motion_blur_shutter > 0 and getattr(layer, "use_motion_blur", True)


def write(work: Work) -> None:
    """Write what was asked for."""
    (Path(work.folder) / JOB).write_text(json.dumps(asdict(work), indent=1), encoding="utf-8")


def finish(work: Work) -> Work:
    """Mark the job as done; the copy of the .blend file goes."""
    done = Work(**asdict(work) | {"finished": True})
    write(done)
    for name in (COPY, f"{COPY}1"):
        (Path(work.folder) / name).unlink(missing_ok=True)
    forget_cache(Path(work.folder) / COPY)
    return done


def cache_of(file: Path) -> Path:
    """Where Blender keeps the physics of a .blend file that are baked to disk."""
    return file.with_name(f"blendcache_{file.stem}")


def share_cache(file: Path, copy: Path) -> None:
    """Let the copy of a .blend file find the physics of the file that are baked to disk."""
    forget_cache(copy)
    if cache_of(file).is_dir():
        try:
            cache_of(copy).symlink_to(cache_of(file).resolve(), target_is_directory=True)
        except OSError:  # Windows gives links to few
            shutil.copytree(cache_of(file), cache_of(copy))


def forget_cache(copy: Path) -> None:
    """Undo `share_cache`."""
    if cache_of(copy).is_symlink():
        cache_of(copy).unlink()
    else:
        shutil.rmtree(cache_of(copy), ignore_errors=True)


def remove_leftovers(work: Work) -> None:
    """Remove what a cancelled program had not finished."""
    rendered = [Path(folder) / UNFINISHED for folder in (work.noisy, work.surfaces) if folder]
    for path in (*rendered, *Path(work.clean).glob("*.tmp")):
        path.unlink(missing_ok=True)


def stages(work: Work, rtdenoise: list[str]) -> list[Stage]:
    """Render what is missing, then denoise."""
    copy, job = str(Path(work.folder) / COPY), str(Path(work.folder) / JOB)
    if bpy.app.binary_path:
        trusted = ["--enable-autoexec"] if not bpy.app.autoexec_fail else []
        command = [bpy.app.binary_path, "--background", *trusted, copy, "--python-exit-code", "1", "--python"]
        command += [str(RENDERER), "--", job]
    else:  # Blender as a Python module
        command = [sys.executable, str(RENDERER), copy, "--", job]
    return [
        Stage("Rendering", command, lambda lines: f"rendering failed: {last_line(lines)}"),
        Stage("Denoising", [*rtdenoise, *work.arguments], _about_denoising),
    ]


def clean_frames(work: Work) -> list[Path]:
    """The results, in order of their numbers, which may differ in length."""
    return sorted(Path(work.clean).glob("frame.*.exr"), key=lambda path: int(path.name.split(".")[1]))


def _about_denoising(lines: list[str]) -> str:
    """rtdenoise's own sentence: errors are one line that ends its output."""
    return f"denoising failed: {last_line(lines)}"
