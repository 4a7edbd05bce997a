"""`rtdenoise view`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class View:
    """Open the report of an evaluation in a web browser; it is written first if it is not there."""

    folder: Annotated[Positional[Path], arg(metavar="OUT")]
    """Folder that evaluate wrote, or a report.html."""

    def run(self) -> None:
        import contextlib
        import webbrowser

        from ..report import find_page

        page, opened = find_page(self.folder), False
        with contextlib.suppress(webbrowser.Error):
            opened = webbrowser.open(page.resolve().as_uri())
        if opened:
            print(f"opened {page}")
        else:
            print(f"no browser to be found here; the report is {page}")
