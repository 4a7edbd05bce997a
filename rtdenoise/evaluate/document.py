"""evaluation.json: every result in one folder, and the methods that were left out with the reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..errors import InputError
from ..files import dumps, read_json, write_atomically
from .registry import PRECISIONS

NAME = "evaluation.json"
FORMAT = "rtdenoise-evaluation-1"
FAMILIES = ("input", "accumulation", "filter", "oidn", "network", "ablation")
NUMBER, KNOWN = (int, float, type(None)), (int, float)  # null: there is none
KEY = {"sequence": str, "spp": int, "method": str, "precision": str, "device": str}
ERRORS = {str: NUMBER}  # by metric
# What a report needs in each part: a type or several, an object with these keys, one with any key (`str`), an array
# whose items are alike, or as many as there are here.
PARTS = {
    "signal": str,
    "runs": [{"command": str, "date": str, "commit": str, "devices": {str: str}, "versions": {str: str}}],
    "sequences": {
        str: {
            "size": [int, int], "frames": [int], "sample_ms": NUMBER, "exposure": KNOWN, "uncovered_share": KNOWN,
            "stills": [int], "reference_psnr": NUMBER, "reference_relmse": NUMBER,
            "playback": {"window": [int, int, int, int], "frames": [int]},
        }
    },
    "methods": {str: {"what": str, "family": str}},
    "results": [
        KEY | {
            "run": int, "fingerprint": str, "ms": {"median": KNOWN}, "errors": {str: ERRORS}, "ghost_length": NUMBER,
            "frames": [{"number": int, "frame": ERRORS, "uncovered": ERRORS}],
        }
    ],
    "skipped": [KEY | {"reason": str}],
}  # fmt: skip
OPTIONAL = {"runs", "sequences", "methods", "results", "skipped", "reference_psnr", "reference_relmse", "playback"}
NAMES = {dict: "a JSON object", list: "a JSON array", str: "a string", int: "a whole number"}


def by_precision(row: dict) -> int:
    """Orders results: fp32 first."""
    return PRECISIONS.index(row["precision"]) if row["precision"] in PRECISIONS else len(PRECISIONS)


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

    def pictured(self, sequence: str, method: str) -> dict | None:
        """The result whose pictures are kept: of the base samples, in fp32 where that was measured."""
        rows = [row for row in self.results if (row["sequence"], row["method"]) == (sequence, method)]
        base = [row for row in rows if row["spp"] == self.sequences[sequence].get("base_spp", row["spp"])]
        return min(base, key=by_precision, default=None)

    def put(self, row: dict) -> None:
        """Add a result, or a row with a `reason` why there is none, in the place of the row with the same key."""
        same = [row[name] for name in KEY]
        self.results = [r for r in self.results if [r[name] for name in KEY] != same]
        self.skipped = [r for r in self.skipped if [r[name] for name in KEY] != same]
        (self.skipped if "reason" in row else self.results).append(row)


def _fault(content: dict) -> str:
    """The first key that is unknown, missing or wrong, in words; empty if there is none."""
    if foreign := sorted(content.keys() - PARTS.keys()):
        return f"unknown key {foreign[0]!r}; expected {', '.join(PARTS)}"
    return _unlike(content, PARTS) or _stray(content)


def _unlike(value: object, shape: object, *path: str | int) -> str:
    """The first part of a value that is not of this shape (`PARTS`), in words; empty if there is none."""
    kind = type(shape) if isinstance(shape, dict | list) else shape
    place = "".join(f"{part}, " for part in path[:-1])
    if not isinstance(value, kind):
        where = f"{place}key {path[-1]!r}" if isinstance(path[-1], str) else f"{place}{path[-1]}"
        return f"{where}: expected {NAMES.get(kind, 'a number')}, found {value!r}"
    if kind is dict:
        here = ", ".join(map(str, path))
        shapes = dict.fromkeys(value, shape[str]) if str in shape else shape
        if lacking := sorted(shapes.keys() - value.keys() - OPTIONAL):
            return f"{here}{': ' if here else ''}key {lacking[0]!r} is missing"
        items = [(key, inner) for key, inner in shapes.items() if key in value]
    elif kind is list:
        items = list(enumerate(shape if len(shape) > 1 else shape * len(value)))
        if len(items) != len(value):
            return f"{place}key {path[-1]!r}: expected {len(items)} items, found {value!r}"
    else:
        return ""
    return next(filter(None, (_unlike(value[key], inner, *path, key) for key, inner in items)), "")


def _stray(content: dict) -> str:
    """A method of no known family, a result whose sequence, method or run the document does not describe, or a sequence
    without a still."""
    for name, method in content.get("methods", {}).items():
        if method["family"] not in FAMILIES:
            return f"methods, {name}: family {method['family']!r}; expected one of {', '.join(FAMILIES)}"
    for i, row in enumerate(content.get("results", [])):
        for key, part in (("sequence", "sequences"), ("method", "methods")):
            if row[key] not in content.get(part, {}):
                return f"results, {i}: {key} {row[key]!r} is not among {part!r}"
        if row["run"] not in range(len(content.get("runs", []))):
            return f"results, {i}: run {row['run']!r} is not among 'runs'"
        if not {"frame", "uncovered"} <= row["errors"].keys():
            return f"results, {i}: expected errors of the region 'frame', and of 'uncovered'"
    for name, sequence in content.get("sequences", {}).items():
        if not sequence["stills"]:
            return f"sequences, {name}: expected a frame in 'stills'"
    return ""
