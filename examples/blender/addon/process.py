"""Programs that run beside Blender: started, watched, stopped. Needs no bpy."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

COUNT = re.compile(r"(\d+)/(\d+)")  # a line that says how far a program is: 3/24
KEPT = 40  # lines of output, for the sentence about a failure
UTF8 = {"PYTHONIOENCODING": "utf-8"}  # a pipe of Windows has the encoding of the language otherwise
PATIENCE = 5.0  # seconds to end after being asked


class Trouble(Exception):
    """Something for the user: one sentence that says what to do."""


@dataclass(frozen=True)
class Stage:
    """One program of a job."""

    label: str
    command: list[str]
    explain: Callable[[list[str]], str]  # the lines it printed -> a sentence, where it failed
    optional: bool = False  # whether the job goes on without it
    after: Callable[[], None] = lambda: None  # to do when it has ended well
    environment: dict[str, str] = field(default_factory=dict)


class Job:
    """Stages, one after the other. `poll` often; `cancel` at any time."""

    def __init__(self, stages: list[Stage]) -> None:
        self.label, self.done, self.total = "", 0, 0
        self.lines: deque[str] = deque(maxlen=KEPT)
        self._stages, self._process, self._reader = list(stages), None, None

    @property
    def fraction(self) -> float:
        """Of the running stage, in [0, 1]."""
        return self.done / self.total if self.total else 0.0

    @property
    def text(self) -> str:
        """For people: `Rendering 3/24`."""
        return f"{self.label} {self.done}/{self.total}" if self.total else f"{self.label} …"

    def poll(self) -> bool:
        """Whether there is more to wait for. Raises Trouble where a stage has failed."""
        if self._process is None:
            return self._start_next()
        if self._process.poll() is None:
            return True
        self._reader.join()
        stage, failed = self._stages.pop(0), self._process.returncode != 0
        self._process = None
        if failed and not stage.optional:
            self._stages.clear()
            raise Trouble(stage.explain(list(self.lines)))
        if not failed:
            stage.after()
        return self._start_next()

    def cancel(self) -> None:
        """End the running program, and all that it has started."""
        process, self._process = self._process, None
        self._stages.clear()
        if process is None or process.poll() is not None:
            return
        _signal_group(process, end=True)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            _signal_group(process, end=False)
            process.wait()

    def _start_next(self) -> bool:
        if not self._stages:
            return False
        stage = self._stages[0]
        self.label, self.done, self.total = stage.label, 0, 0
        self.lines.clear()
        group = {"start_new_session": True} if os.name == "posix" else {"creationflags": 0x200}  # a group of its own
        try:
            self._process = subprocess.Popen(
                stage.command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                encoding="utf-8", errors="replace", env=clean_environment() | UTF8 | stage.environment, **group,
            )  # fmt: skip
        except OSError as error:
            self._stages.clear()
            raise Trouble(f"{stage.command[0]} does not start ({error.strerror}); choose another Python in the "
                          "add-on's preferences") from None  # fmt: skip
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), daemon=True)
        self._reader.start()
        return True

    def _read(self, stream) -> None:
        for line in stream:
            line = line.strip()
            if match := COUNT.fullmatch(line):
                self.done, self.total = int(match[1]), int(match[2])
            elif line:
                self.lines.append(line)


def clean_environment() -> dict[str, str]:
    """The environment without Blender's own Python in it."""
    return {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}


def last_line(lines: list[str]) -> str:
    """What a program printed last."""
    return lines[-1] if lines else "it printed nothing"


def is_writable(folder: Path) -> str:
    """Make the folder and try to write into it: "" if that works, else the reason."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".rtdenoise-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _signal_group(process: subprocess.Popen, end: bool) -> None:
    if os.name != "posix":
        process.terminate() if end else process.kill()
        return
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM if end else signal.SIGKILL)
