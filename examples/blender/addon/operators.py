"""What the buttons do. One job runs at a time; it is watched by a timer, so Blender stays usable."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import bpy

from . import compositor, environment, passes, work
from .process import Job, Trouble

INTERVAL = 0.25  # seconds between two looks at the job
running: Job | None = None
message = ""  # how the last job ended
# OSError: a full disk, a folder that is gone. RuntimeError: what Blender raises where it cannot save or load a file.
TROUBLES = Trouble, OSError, RuntimeError


def preferences(context: bpy.types.Context) -> bpy.types.AddonPreferences | None:
    """The add-on's, None where it is not installed as one."""
    addon = context.preferences.addons.get(__package__)
    return addon and addon.preferences


def own_environment() -> Path:
    """The folder of the environment that the add-on makes."""
    try:
        return Path(bpy.utils.extension_path_user(__package__, path="environment", create=True))
    except (AttributeError, ValueError):  # not installed as an extension
        return Path(bpy.utils.user_resource("CONFIG", path="rtdenoise", create=True)) / "environment"


def shipped_wheel() -> Path | None:
    """The wheel of rtdenoise inside the add-on."""
    return next(iter(sorted(Path(__file__).parent.glob("rtdenoise-*.whl"))), None)


def find_or_make(context: bpy.types.Context) -> tuple[list[str], list]:
    """A command that runs rtdenoise, and the stages that have to be run before. Raises Trouble."""
    chosen, own = preferences(context), own_environment()
    wheel = shipped_wheel()
    found = environment.find(bpy.path.abspath(chosen.python) if chosen and chosen.python else "", own, wheel)
    if found:
        return found, []
    index = chosen.torch_index if chosen else ""
    stages = environment.stages_to_make(own, wheel, index, getattr(bpy.app, "online_access", True))
    return [str(own / environment.PYTHON), "-m", "rtdenoise"], stages


class Watched:
    """An operator that starts a `Job` and watches it: modal in a window, waiting without one."""

    _timer = None

    def job(self, context: bpy.types.Context) -> Job:
        """The job to start. Raises Trouble."""
        raise NotImplementedError

    def finished(self, context: bpy.types.Context) -> str:
        """What to do at the end, and to tell."""
        raise NotImplementedError

    def cleared(self) -> None:
        """What to do after a job that was cancelled or has failed."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self._begin(context):
            return {"CANCELLED"}
        while (result := self._look(context)) is None:
            time.sleep(INTERVAL / 5)
        return result

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        redraw(context)
        return self._look(context) or {"PASS_THROUGH"}

    def _begin(self, context: bpy.types.Context) -> bool:
        global running, message
        if running is not None:
            self.report({"ERROR"}, "A job is running: wait for it, or cancel it")
            return False
        message = ""
        try:
            running = self.job(context)
        except TROUBLES as trouble:
            self._tell({"ERROR"}, trouble)
            return False
        return True

    def _look(self, context: bpy.types.Context) -> set[str] | None:
        """The result of the operator once the job has ended."""
        try:
            if running is None:
                self.cleared()
                self._tell({"WARNING"}, "Cancelled; Continue goes on from here")
                return self._end(context, {"CANCELLED"})
            if running.poll():
                return None
            self._tell({"INFO"}, self.finished(context))
            return self._end(context, {"FINISHED"})
        except TROUBLES as trouble:
            with contextlib.suppress(OSError):
                self.cleared()
            self._tell({"ERROR"}, trouble)
            return self._end(context, {"CANCELLED"})

    def _end(self, context: bpy.types.Context, result: set[str]) -> set[str]:
        global running
        running = None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        redraw(context)
        return result

    def _tell(self, kind: set[str], sentence: object) -> None:
        global message
        message = " ".join(str(sentence).split())  # Blender's own end in a line break
        self.report(kind, message[:1].upper() + message[1:])


class RTDENOISE_OT_animation(Watched, bpy.types.Operator):
    """Render the frame range at few samples, denoise it, and put the result into the compositor"""

    bl_idname, bl_label = "rtdenoise.animation", "Denoise Animation"
    go_on: bpy.props.BoolProperty(
        name="Continue", description="Go on with the job that was cancelled", options={"SKIP_SAVE"}
    )

    def job(self, context: bpy.types.Context) -> Job:
        scene, folder = context.scene, work.folder_of(context.scene)
        if obstacle := passes.obstacle(scene, context.view_layer):
            raise Trouble(obstacle)
        if self.go_on and not work.can_go_on(folder):
            raise Trouble(f"{folder} holds no cancelled job: click Denoise Animation")
        command, stages = find_or_make(context)
        passes.switch_on(context.view_layer)
        self.work = work.read(folder) if self.go_on else work.begin(context)
        return Job(stages + work.stages(self.work, command))

    def finished(self, context: bpy.types.Context) -> str:
        done = work.finish(self.work)
        compositor.insert(bpy.data.scenes.get(done.scene) or context.scene, done)
        return f"{len(work.clean_frames(done))} denoised frames are in {done.clean} and in the compositor"

    def cleared(self) -> None:
        work.remove_leftovers(self.work)


class RTDENOISE_OT_passes(bpy.types.Operator):
    """Switch on the passes of this view layer that the denoiser reads"""

    bl_idname, bl_label = "rtdenoise.passes", "Switch On"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (as Blender wants it)

    def execute(self, context: bpy.types.Context) -> set[str]:
        passes.switch_on(context.view_layer)
        return {"FINISHED"}


class RTDENOISE_OT_environment(Watched, bpy.types.Operator):
    """Make a Python environment with PyTorch and rtdenoise: some hundred MB are downloaded once"""

    bl_idname, bl_label = "rtdenoise.environment", "Install rtdenoise"

    def job(self, context: bpy.types.Context) -> Job:
        return Job(find_or_make(context)[1])

    def finished(self, context: bpy.types.Context) -> str:
        return f"rtdenoise is ready: {' '.join(find_or_make(context)[0])}"


class RTDENOISE_OT_cancel(bpy.types.Operator):
    """Stop the running job; finished frames stay, and Continue goes on from there"""

    bl_idname, bl_label = "rtdenoise.cancel", "Cancel"

    def execute(self, context: bpy.types.Context) -> set[str]:
        cancel()
        return {"FINISHED"}


def cancel() -> None:
    """Stop the job, if one is running."""
    global running
    job, running = running, None
    if job is not None:
        job.cancel()


def redraw(context: bpy.types.Context) -> None:
    """Show the progress in every properties editor."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()


CLASSES = (RTDENOISE_OT_animation, RTDENOISE_OT_passes, RTDENOISE_OT_environment, RTDENOISE_OT_cancel)
