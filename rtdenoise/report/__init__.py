"""From evaluation.json to something to look at: report.html, report.md and report.png beside it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from ..errors import InputError
from ..evaluate.document import Document
from ..files import write_atomically
from .markdown import markdown
from .page import page, payload

__all__ = ["report"]


def report(folder: Path, pictures: tuple[str, ...] = (), sequences: tuple[str, ...] = ()) -> list[Path]:
    """Write the reports of what `rtdenoise evaluate` measured into `folder`; returns the files.

    `pictures` and `sequences`: methods and sequences whose pictures the page holds, all if empty. report.png needs
    matplotlib and is left out where that is not installed. Raises InputError where there is no evaluation.json, or a
    method is none of it.
    """
    folder = Path(folder)
    document = Document.read(folder)
    if unknown := [name for name in pictures if name not in document.methods]:
        raise InputError(f"no method {unknown[0]!r} in {folder}; it has {', '.join(document.methods)}")
    data = payload(document)
    written = {
        folder / "report.html": page(data, document, folder, pictures, sequences).encode(),
        folder / "report.md": markdown(data).encode(),
    }
    if importlib.util.find_spec("matplotlib"):
        from .chart import chart

        written[folder / "report.png"] = chart(data)
    for path, content in written.items():
        write_atomically(path, content)
    return list(written)
