"""Publish a result: a JSON file that says where it is from, and the sections of pages that are made from it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from pathlib import Path

from rtdenoise.evaluate.origin import device_name, origin
from rtdenoise.files import dumps, write_atomically

from .. import ROOT
from .columns import pack, unpack

Tables = Callable[[dict], dict[str, str]]  # document -> section -> Markdown


def publish(
    path: Path,
    content: dict[str, object],
    *,
    devices: dict[str, str] | None = None,
    digits: int | None = None,
    pages: Sequence[Path] = (),
    tables: Tables | None = None,
) -> dict:
    """Write `content` with its command, date, commit and devices to `path`, then update the sections of `pages`.

    `devices`: backend -> name of its device; by default torch on the CPU. `digits`: significant digits of the numbers;
    None keeps all. Timings become dictionaries. Returns the document as it stands in the file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    facts = origin(command_line(), devices or {"torch": cpu()})
    write_atomically(path, laid_out({**facts, **content}, digits).encode())
    print(f"written: {path}")
    document = read(path)
    if tables is not None:
        insert_sections(tables(document), pages)
    return document


def read(path: Path) -> dict:
    """A document that `publish` wrote."""
    return {key: unpack(value) for key, value in json.loads(path.read_text()).items()}


def times_kept(path: Path) -> dict:
    """The times in a document, and where they are from: for errors that are measured anew on another CPU."""
    document = read(path)
    return {"times": document["times"], "times_of": document.get("times_of") or _measured(document)}


def sets_kept(path: Path, others: Collection[str]) -> tuple[list[dict], dict[str, dict]]:
    """The rows of a document but for those of the sets `others`, measured anew; and where each set is from."""
    document = read(path)
    rows = [row for row in document["rows"] if row["set"] not in others]
    known = document.get("sets_of", {})
    return rows, {row["set"]: known.get(row["set"]) or _measured(document) for row in rows}


def _measured(document: dict) -> dict:
    return {fact: document[fact] for fact in ("date", "commit", "devices")}


def laid_out(document: dict[str, object], digits: int | None = None) -> str:
    """JSON with a line for each value, and for each row of a list; the names of like rows stand once (columns.py)."""

    def line(value: object) -> str:
        return dumps(value, digits, default=asdict, ensure_ascii=False)

    def lines(value: object) -> str:
        if value is not (packed := pack(value)):
            return "{" + ",\n ".join(f"{line(key)}: {lines(part)}" for key, part in packed.items()) + "}"
        rows = isinstance(value, list) and all(isinstance(row, list | dict) for row in value)
        return "[\n  " + ",\n  ".join(map(line, value)) + "\n ]" if rows and value else line(value)

    return "{\n" + ",\n".join(f" {line(key)}: {lines(value)}" for key, value in document.items()) + "\n}\n"


def insert_sections(sections: dict[str, str], pages: Sequence[Path]) -> None:
    """Put each text between `<!-- name -->` and `<!-- /name -->`, on every page that has these marks.

    Ends the program with a line for the sections that no page has, after all others are updated.
    """
    missing = dict(sections)
    for page in pages:
        text = page.read_text()
        for name, section in sections.items():
            before, found, rest = text.partition(f"<!-- {name} -->\n")
            _, closed, after = rest.partition(f"<!-- /{name} -->")
            if found and closed:
                text = f"{before}{found}{section}\n{closed}{after}"
                missing.pop(name, None)
        page.write_text(text)
    if missing:
        names = ", ".join(str(os.path.relpath(page, ROOT)) for page in pages)
        sys.exit(f"{names}: expected the marks {', '.join(f'<!-- {n} --> … <!-- /{n} -->' for n in missing)}")


def command_line() -> str:
    """The running command, with the script relative to the repository."""
    return " ".join(["python", os.path.relpath(sys.argv[0], ROOT), *sys.argv[1:]])


def cpu() -> str:
    """The processor, and how many of its threads torch uses."""
    return device_name("cpu")


def beside(document: dict, row: dict, method: str) -> dict:
    """The row of another method on the same sequence and signal."""
    key = row["sequence"], row["signal"], method
    return next(r for r in document["rows"] if (r["sequence"], r["signal"], r["method"]) == key)
