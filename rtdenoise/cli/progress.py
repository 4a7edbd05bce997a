"""The progress bar of all commands: what is being done, how far it is, how long it will take."""

from __future__ import annotations

from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn


def progress_bar(label: str, *more: ProgressColumn) -> Progress:
    """A bar that says `label`; `more` columns follow after the time that remains."""
    return Progress(TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), *more)
