"""The progress bar of all commands: what is being done, how far it is, how long it will take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn


class Bar(Progress):
    """A progress bar that appears with the first `update`: nothing of it is seen where a command fails before."""

    def __enter__(self) -> Bar:
        return self

    def update(self, *arguments, **fields) -> None:
        super().update(*arguments, **fields)
        self.start()  # again: does nothing

    def stop(self) -> None:
        if self.live.is_started:
            super().stop()


def progress_bar(label: str, *more: ProgressColumn) -> Bar:
    """A bar that says `label`; `more` columns follow after the remaining time. Its console prints text as it is."""
    console = Console(markup=False, emoji=False, highlight=False)
    return Bar(TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), *more, console=console)


@contextmanager
def frame_progress(kind: str, label: str) -> Iterator[Callable[[int, int], None]]:
    """What takes (frames done, total): a bar that says `label`, or with the kind 'lines' a line a frame."""
    if kind == "lines":
        yield lambda done, total: print(f"{done}/{total}", flush=True)
        return
    with progress_bar(label) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
