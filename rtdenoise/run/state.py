"""The state of a run, kept in its output folder: how far it came, its history and its summary so far."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..data.sequences import Sequence
from ..data.stored import read_history, write_history
from ..errors import InputError
from .backends import Backend
from .options import Options
from .summary import Summary

STATE = ".rtdenoise-state.safetensors"  # in the output folder: the history after the last finished frame
MARKS = ("fingerprint", "written")  # of the input, and of the finished files
FINISHED = "finished"  # of a whole run whose state is that before its last frames
LARGE, PAUSE = 2**18, 2.0  # pixels beyond which a picture is large, and seconds between states then
COUNTS = ("replaced", "passed_on", "cuts", "left_out", "exposure")  # of the summary, which a state keeps with its notes


class Due:
    """When the state of a run is saved: after each frame; of large pictures, whose states are large, too, once in a
    while. A run that is interrupted repeats the frames since."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._pause = PAUSE if math.prod(size) > LARGE else 0.0
        self._last = time.monotonic()

    def now(self, last: bool) -> bool:
        """Whether it is saved now, as it always is after the `last` frame."""
        if not last and time.monotonic() - self._last < self._pause:
            return False
        self._last = time.monotonic()
        return True


def read_state(path: Path, backend: Backend | None = None) -> tuple[int, Any, Summary, dict]:
    """What `save_state` wrote: frames done, the history (None without a backend to restore it), the summary so far, and
    the rest. Raises InputError where the file is damaged."""
    try:
        stored, metadata = read_history(path)
        done, summary = int(metadata["done"]), _counts(json.loads(metadata["so_far"]))
        recorded = {key: metadata[key] for key in MARKS}
        recorded["counted"] = int(metadata.get("counted", done))
        recorded["options"] = dict(json.loads(metadata["options"]))
        recorded["finished"] = None
        if FINISHED in metadata:
            finished = json.loads(metadata[FINISHED])
            recorded["finished"] = {"summary": _counts(finished["so_far"])} | {key: str(finished[key]) for key in MARKS}
        history = backend.restore(stored) if stored and backend else None
    except (InputError, KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not readable ({error}); pass --overwrite to start anew") from None
    return done, history, summary, recorded


def _counts(so_far: dict) -> Summary:
    """The summary of an earlier run, from its saved state. Raises ValueError and others where it is not one's."""
    summary = Summary(**{key: so_far[key] for key in COUNTS})
    counts = (summary.replaced, summary.left_out, summary.passed_on)
    if not all(type(n) is int for n in (*summary.cuts, *(n for count in counts for n in count.values()))):
        raise ValueError("counts that are no integers")
    gains = summary.exposure
    if not (isinstance(gains, list) and all(type(gain) is float and 0 < gain < math.inf for gain in gains)):
        raise ValueError("brightness that is not positive")
    notes = so_far.get("notes", [])
    if not (isinstance(notes, list) and all(isinstance(note, str) for note in notes)):
        raise ValueError("notes that are no text")
    summary.notes = notes
    return summary


def save_state(
    path: Path, history: dict, done: int, fingerprint: str, summary: Summary, options: Options, written: str = "",
    counted: int = 0,
) -> None:  # fmt: skip
    """Write the state of a run: `history` is a backend's `save`, `written` a `folder.Written.digest`, `counted` the
    frames that the summary counts, where they are more than are done."""
    metadata = {"done": str(done), "fingerprint": fingerprint, "so_far": _so_far(summary), "written": written}
    metadata["counted"] = str(max(done, counted))
    write_history(path, history, metadata | {"options": json.dumps(asdict(options))})


def finish_state(path: Path, fingerprint: str, summary: Summary, written: str) -> None:
    """Note in the state of a run that it has come to its end, with frames that lacked some of those after them, or with
    notes that hold while no frames are appended."""
    history, metadata = read_history(path)
    finished = {"fingerprint": fingerprint, "so_far": json.loads(_so_far(summary)), "written": written}
    write_history(path, history, metadata | {FINISHED: json.dumps(finished)})


def _so_far(summary: Summary) -> str:
    return json.dumps({key: getattr(summary, key) for key in (*COUNTS, "notes")})


def linked(sequence: Sequence, i: int, cuts: list[int]) -> bool:
    """Whether frame i goes on with the shot of the frame before."""
    number = sequence.numbers[i]
    return number == sequence.numbers[i - 1] + 1 and number not in cuts


def last_of_shot(sequence: Sequence, done: int, cuts: list[int], most: int) -> list[int]:
    """The frames before frame `done` that belong to the shot of the last of them, at most `most`, the newest first."""
    first = done
    while done - first < most and first > 0 and (first == done or linked(sequence, first, cuts)):
        first -= 1
    return list(reversed(range(first, done)))
