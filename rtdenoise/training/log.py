"""The log of a training run: `log.jsonl`, a line per logged step and per validation; on request TensorBoard's too."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

from ..errors import InputError
from ..files import dumps, read_text, write_atomically


class Log:
    """Open for appending after `step`. Lines of later steps are dropped: a killed run repeats the steps after its last
    checkpoint. A context manager.

    Raises InputError where TensorBoard is asked for and not installed, and where a line of the file is damaged.
    """

    def __init__(self, out: Path, step: int, tensorboard: bool = False) -> None:
        path = out / "log.jsonl"
        if path.exists():
            write_atomically(path, "".join(_lines(path, step)).encode())
        self._board = _board(out / "tensorboard", step) if tensorboard else None
        self._file = path.open("a")

    def write(self, row: Mapping[str, object]) -> None:
        """Numbers of the step `row["step"]`; groups of them may be nested. TensorBoard gets no lists."""
        self._file.write(dumps(row) + "\n")
        self._file.flush()
        if self._board:
            for name, value in row.items():
                if isinstance(value, list):
                    continue
                for inner, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                    self._board.add_scalar(f"{name}/{inner}".rstrip("/"), number, row["step"])
            self._board.flush()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._board:
            self._board.close()


def _lines(path: Path, step: int) -> Iterator[str]:
    """The lines up to `step`, without a last one that is incomplete. Raises InputError for lines that are no rows."""
    for number, line in enumerate(read_text(path).splitlines(keepends=True), 1):
        if not line.endswith("\n"):
            return
        try:
            row = json.loads(line)
            of = row["step"] if isinstance(row, dict) else None
        except (ValueError, KeyError, RecursionError):
            of = None
        if type(of) is not int:
            raise InputError(f"{path}: line {number} is damaged: expected JSON with a 'step'; remove that line")
        if of <= step:
            yield line


def _board(folder: Path, step: int):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise InputError("--tensorboard needs TensorBoard: pip install 'rtdenoise[tensorboard]'") from None
    return SummaryWriter(str(folder), purge_step=step + 1)
