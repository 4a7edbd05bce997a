"""`rtdenoise estimates`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from ..errors import InputError
from ..wording import counted
from .lists import split_names
from .progress import progress_bar


@dataclass(frozen=True)
class Estimates:
    """Denoise training clips and store the frames beside them: a combiner trains to correct these."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="CLIPS ...", help_behavior_hint="(required)")]
    """Folders of clips, at least one."""
    methods: tuple[str, ...] = ("oidn", "default")
    """Methods of `evaluate`; each writes into the folder CLIPS/METHOD."""
    signal: Literal["color", "indirect", "both"] = "both"
    """The signal to denoise."""

    def run(self) -> None:
        if not self.folders:
            raise InputError("no clips: name at least one folder of clips")
        from ..evaluate.estimates import write_all

        if not (methods := split_names(self.methods)):
            raise InputError("--methods: name at least one method")
        signals = ("color", "indirect") if self.signal == "both" else (self.signal,)
        with progress_bar("estimates") as bar:
            task = bar.add_task("estimates", total=None)

            def on_clip(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)

            count = write_all(self.folders, methods, signals, on_clip)
        names = " ".join(method.partition("=")[0] for method in methods)  # those of NAME=FILE are in the folder NAME
        learn = "" if methods == Estimates.methods else f" --estimates {names}"
        written = f"{counted(count, 'estimate')} written"
        print(f"{written}; train with: rtdenoise train --model combiner --frames 5{learn} --data ...")
