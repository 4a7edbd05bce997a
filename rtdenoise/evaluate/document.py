"""evaluation.json: every result in one folder, and the methods that were left out with the reason."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

from ..errors import InputError
from ..files import dumps, read_json, write_atomically

NAME = "evaluation.json"
FORMAT = "rtdenoise-evaluation-1"
KEY = ("sequence", "spp", "method", "precision", "device")
# Keys that a report needs in each part.
RESULT = {*KEY, "run", "fingerprint", "ms", "errors", "ghost_length", "frames"}
SKIPPED = {*KEY, "reason"}
SEQUENCE = {"size", "frames", "sample_ms", "exposure", "uncovered_share", "stills"}
METHOD = {"what", "family"}
FAMILIES = ("input", "accumulation", "filter", "oidn", "network", "ablation")
RUN = {"command", "date", "commit", "devices", "versions"}


@dataclass
class Document:
    """The file as an object. Lists and dictionaries hold JSON values; errors that do not exist are null.

    runs        origin of the numbers (`origin.origin`); a result names its run by the index
    sequences   name -> size [H, W], frames, exposure, share of uncovered pixels, relMSE and PSNR of the reference
                itself, time of a sample, stills; with a "plan", its "decisions" have what, left_out and why; with a
                "playback", its frames and "window" (top, left, height, width) are those of the strips
    methods     name -> what it is, family
    results     one row for each sequence, spp, method, precision and device
    skipped     rows with the same key and a reason
    """

    signal: str
    runs: list[dict] = field(default_factory=list)
    sequences: dict[str, dict] = field(default_factory=dict)
    methods: dict[str, dict] = field(default_factory=dict)
    results: list[dict] = field(default_factory=list)
    skipped: list[dict] = field(default_factory=list)

    @classmethod
    def open(cls, folder: Path, signal: str) -> Document:
        """The results in a folder, or none yet. Raises InputError as `read`, and where they are of another signal."""
        if not (folder / NAME).exists():
            return cls(signal)
        document = cls.read(folder)
        if document.signal != signal:
            raise InputError(f"{folder}: holds results of the signal '{document.signal}'; choose another --out")
        return document

    @classmethod
    def read(cls, folder: Path) -> Document:
        """The document of a folder. Raises InputError where the file is missing, or `write` did not write it."""
        path = Path(folder) / NAME
        if not path.exists():
            inside = " or ".join(str(found.parent) for found in sorted(path.parent.glob(f"*/{NAME}")))
            advice = f"choose {inside}" if inside else f"`rtdenoise evaluate SEQ --out {folder}` writes it"
            raise InputError(f"{path}: not there; {advice}")
        content = read_json(path)
        found = content.pop("format", None) if isinstance(content, dict) else None
        if found != FORMAT:
            raise InputError(f"{path}: expected the format {FORMAT!r}, found {found!r}")
        if wrong := _fault(content):
            raise InputError(f"{path}: {wrong}; evaluate into another --out, or delete that file")
        return cls(**content)

    def write(self, folder: Path) -> None:
        """Write the file whole or not at all."""
        text = dumps({"format": FORMAT, **vars(self)}, indent=1) + "\n"
        write_atomically(Path(folder) / NAME, text.encode())

    def find(self, **key: object) -> dict | None:
        """The result with this key."""
        return next((row for row in self.results if all(row[name] == key[name] for name in KEY)), None)

    def put(self, row: dict) -> None:
        """Add a result, or a row with a `reason` why there is none, in the place of the row with the same key."""
        same = [row[name] for name in KEY]
        self.results = [r for r in self.results if [r[name] for name in KEY] != same]
        self.skipped = [r for r in self.skipped if [r[name] for name in KEY] != same]
        (self.skipped if "reason" in row else self.results).append(row)


def _fault(content: dict) -> str:
    """The first key that is unknown, missing or wrong, in words; empty if there is none."""
    known = [f.name for f in fields(Document)]
    if foreign := sorted(content.keys() - set(known)):
        return f"unknown key {foreign[0]!r}; expected {', '.join(known)}"
    if not isinstance(content.get("signal"), str):
        return "key 'signal' is missing"
    for part, kind in (("runs", list), ("sequences", dict), ("methods", dict), ("results", list), ("skipped", list)):
        if not isinstance(content.get(part, kind()), kind):
            return f"key {part!r}: expected a JSON {'array' if kind is list else 'object'}"
    return next(filter(None, (_missing(content, *part) for part in (
        ("runs", RUN), ("sequences", SEQUENCE), ("methods", METHOD), ("results", RESULT), ("skipped", SKIPPED),
    ))), "") or _stray(content)  # fmt: skip


def _missing(content: dict, part: str, keys: set[str]) -> str:
    rows = content.get(part, [])
    for name, row in rows.items() if isinstance(rows, dict) else enumerate(rows):
        if not isinstance(row, dict):
            return f"{part}, {name}: expected a JSON object, found {row!r}"
        if lacking := sorted(keys - row.keys()):
            return f"{part}, {name}: key {lacking[0]!r} is missing"
    return ""


def _stray(content: dict) -> str:
    """A method of no known family, or a result whose sequence, method or run the document does not describe."""
    for name, method in content.get("methods", {}).items():
        if method["family"] not in FAMILIES:
            return f"methods, {name}: family {method['family']!r}; expected one of {', '.join(FAMILIES)}"
    for i, row in enumerate(content.get("results", [])):
        for key, part in (("sequence", "sequences"), ("method", "methods")):
            if row[key] not in content.get(part, {}):
                return f"results, {i}: {key} {row[key]!r} is not among {part!r}"
        if row["run"] not in range(len(content.get("runs", []))):
            return f"results, {i}: run {row['run']!r} is not among 'runs'"
        if not isinstance(row["errors"], dict) or "frame" not in row["errors"] or "median" not in dict(row["ms"]):
            return f"results, {i}: expected errors of the region 'frame' and a median of 'ms'"
    return ""
