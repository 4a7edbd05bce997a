"""The log of a training run: `log.jsonl`, a line per logged step and per validation; on request TensorBoard's too."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError
from ..files import dumps


class Log:
    """Open for appending after `step`. Lines of later steps are dropped: a killed run repeats the steps after its last
    checkpoint. A context manager.

    Raises InputError where TensorBoard is asked for and not installed.
    """

    def __init__(self, out: Path, step: int, tensorboard: bool = False) -> None:
        path = out / "log.jsonl"
        if path.exists():
            lines = path.read_text().splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
            path.write_text("".join(kept))
        self._board = _board(out / "tensorboard", step) if tensorboard else None
        self._file = path.open("a")

    def write(self, row: Mapping[str, object]) -> None:
        """Numbers of the step `row["step"]`; groups of them may be nested."""
        self._file.write(dumps(row) + "\n")
        self._file.flush()
        if self._board:
            for name, value in row.items():
                for inner, number in value.items() if isinstance(value, Mapping) else [("", value)]:
                    self._board.add_scalar(f"{name}/{inner}".rstrip("/"), number, row["step"])
            self._board.flush()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._board:
            self._board.close()


def _board(folder: Path, step: int):
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise InputError("--tensorboard needs TensorBoard: pip install 'rtdenoise[tensorboard]'") from None
    return SummaryWriter(str(folder), purge_step=step + 1)
