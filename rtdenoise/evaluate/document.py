"""evaluation.json: everything that was measured into one folder, and what was not and why."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import InputError
from ..files import dumps, write_atomically

NAME = "evaluation.json"
FORMAT = "rtdenoise-evaluation-1"
KEY = ("sequence", "spp", "method", "precision", "device")


@dataclass
class Document:
    """The file as an object. Lists and dictionaries hold what JSON does; errors that do not exist are null.

    runs        where the numbers are from (`origin.origin`); a result names the run by its number
    sequences   name -> size [H, W], frames, exposure, share of uncovered pixels, the reference's own relMSE and PSNR,
                cost of a sample, stills; where there is one, the "plan", of whose "decisions" each has what, left_out
                and why
    methods     name -> what it is, family
    results     one row a sequence, spp, method, precision and device
    skipped     rows of the same key with a reason instead
    """

    signal: str
    runs: list[dict] = field(default_factory=list)
    sequences: dict[str, dict] = field(default_factory=dict)
    methods: dict[str, dict] = field(default_factory=dict)
    results: list[dict] = field(default_factory=list)
    skipped: list[dict] = field(default_factory=list)

    @classmethod
    def read(cls, folder: Path) -> Document:
        """Raises InputError where the file is missing, or is none of ours."""
        path = Path(folder) / NAME
        try:
            content = json.loads(path.read_text())
        except OSError:
            raise InputError(f"{path}: not there; `rtdenoise evaluate SEQ --out {folder}` writes it") from None
        except ValueError as error:
            raise InputError(f"{path}: not JSON ({error})") from None
        found = content.pop("format", None) if isinstance(content, dict) else None
        if found != FORMAT:
            raise InputError(f"{path}: expected the format {FORMAT!r}, found {found!r}")
        return cls(**content)

    def write(self, folder: Path) -> None:
        """Never half a file."""
        text = dumps({"format": FORMAT, **vars(self)}, indent=1) + "\n"
        write_atomically(Path(folder) / NAME, text.encode())

    def find(self, **key: object) -> dict | None:
        """The result with this key."""
        return next((row for row in self.results if all(row[name] == key[name] for name in KEY)), None)

    def put(self, row: dict) -> None:
        """Add a result, or a row with a `reason` why there is none, in the place of what was known of its key."""
        same = [row[name] for name in KEY]
        self.results = [r for r in self.results if [r[name] for name in KEY] != same]
        self.skipped = [r for r in self.skipped if [r[name] for name in KEY] != same]
        (self.skipped if "reason" in row else self.results).append(row)
