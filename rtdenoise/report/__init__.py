"""evaluation.json drawn: report.html, report.md and report.png beside it."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from ..errors import InputError, did_you_mean
from ..evaluate.document import NAME, Document
from ..files import utf8, write_atomically
from .markdown import markdown
from .page import page, payload

__all__ = ["find_page", "report"]


def report(folder: Path, pictures: tuple[str, ...] = (), sequences: tuple[str, ...] = ()) -> list[Path]:
    """Write the reports of the evaluation in `folder` beside it; returns the files.

    `pictures` and `sequences`: methods and sequences whose pictures the page holds, all if empty. report.png needs
    matplotlib and is left out where that is not installed. Raises InputError where evaluation.json is missing, or has
    no such method or sequence.
    """
    folder = Path(folder)
    document = Document.read(folder)
    for kind, names, known in (("method", pictures, document.methods), ("sequence", sequences, document.sequences)):
        for name in names:
            if name not in known:
                near = did_you_mean(name, known)
                raise InputError(f"no {kind} {name!r} in {folder}{near}; it has {', '.join(known)}")
    data = payload(document)
    written = {
        folder / "report.html": utf8(page(data, document, folder, pictures, sequences)),
        folder / "report.md": utf8(markdown(data)),
    }
    if importlib.util.find_spec("matplotlib"):
        from .chart import chart

        written[folder / "report.png"] = chart(data)
    for path, content in written.items():
        write_atomically(path, content)
    return list(written)


def find_page(path: Path) -> Path:
    """The report.html of a folder, or `path` itself if it is such a page. It is written where it is missing or older
    than evaluation.json. Raises InputError where there is neither, and for another file."""
    path = Path(path)
    if path.is_file():
        if path.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"{path}: is no report; name the folder that `rtdenoise evaluate` wrote, or a report.html")
        return path
    page, numbers = path / "report.html", path / NAME
    if not page.is_file() or (numbers.is_file() and numbers.stat().st_mtime > page.stat().st_mtime):
        report(path)
    return page
