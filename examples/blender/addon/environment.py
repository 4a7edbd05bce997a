"""A Python with rtdenoise: found, or made once beside Blender's settings. Needs no bpy."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from .process import Stage, Trouble, clean_environment, last_line

READY = "rtdenoise-is-ready"  # a file in the environment, once its installation has ended well: of which wheel it is
OIDN = "pyoidn>=2.3"  # a second opinion on every frame, used where it can be installed
TRIAL = "import rtdenoise.cli.main; rtdenoise.load()"
PYTHON = Path("Scripts", "python.exe") if os.name == "nt" else Path("bin", "python")
CHOOSE = "choose a Python that has rtdenoise in the add-on's preferences"
OFFLINE_WORDS = ("Temporary failure in name resolution", "NewConnectionError", "Name or service not known",
                 "getaddrinfo failed", "No matching distribution", "Max retries exceeded", "ProxyError")  # fmt: skip


def find(chosen: str, own: Path, wheel: Path | None = None) -> list[str] | None:
    """The start of a command that runs rtdenoise: the Python (or `rtdenoise`) that the user has chosen, the environment
    `own`, if it is of this wheel, or `rtdenoise` on the PATH. None: there is none. Raises Trouble where the chosen one
    has no rtdenoise."""
    if chosen:
        path = Path(chosen).expanduser()
        if not path.is_file():
            raise Trouble(f"{path} is no file: choose a Python that has rtdenoise in the add-on's preferences, or none")
        command = _command(path)
        if not _works(command):
            raise Trouble(f"{path} has no rtdenoise that knows what the add-on asks for: clear the field in the "
                          "add-on's preferences, or install rtdenoise there")  # fmt: skip
        return command
    if _is_made(own) and (wheel is None or (own / READY).read_text(encoding="utf-8") == _fingerprint(wheel)):
        return [str(own / PYTHON), "-m", "rtdenoise"]
    found = shutil.which("rtdenoise")
    return [found] if found and _works([found]) else None


def stages_to_make(own: Path, wheel: Path | None, index: str, online: bool, base: str = sys.executable) -> list[Stage]:
    """The stages that make the environment `own` with Blender's Python, or bring one of another wheel up to date.
    `index`: pip's address of PyTorch builds.

    Raises Trouble where that cannot work.
    """
    if not base or not Path(base).is_file():
        raise Trouble(f"Blender came without Python: {CHOOSE}")
    if wheel is None:
        raise Trouble(f"this copy of the add-on lacks rtdenoise: take the zip that 'make addon' builds, or {CHOOSE}")
    python = str(own / PYTHON)
    pip = [python, "-m", "pip", "--disable-pip-version-check", "--retries", "1", "install", "--no-input"]
    trial = Stage("Trying rtdenoise", [python, "-c", TRIAL], _about_pip, after=lambda: _note(own, wheel))
    if _is_made(own):
        needs = Stage("Downloading what is new", [*pip, f"{wheel}[torch]"], _about_pip)  # mostly nothing
        update = Stage("Updating rtdenoise", [*pip, "--force-reinstall", "--no-deps", str(wheel)], _about_pip)
        return [update, *([needs] if online else []), trial]
    if not online:
        raise Trouble(f"allow online access in Preferences > System: PyTorch is downloaded once; or {CHOOSE}")
    chosen = [Stage("Downloading PyTorch", [*pip, "--index-url", index, "torch"], _about_pip, optional=True)]
    return [
        Stage("Making a Python environment", [base, "-m", "venv", "--clear", str(own)], _about_venv),
        *(chosen if index else ()),  # as a requirement of the wheel alone PyTorch comes in pip's usual build
        Stage("Downloading rtdenoise", [*pip, f"{wheel}[torch]"], _about_pip),
        Stage("Downloading OIDN", [*pip, OIDN], _about_pip, optional=True),
        trial,
    ]


def _is_made(own: Path) -> bool:
    """Whether the installation of an environment has ended well."""
    return (own / READY).is_file() and (own / PYTHON).exists()


def _note(own: Path, wheel: Path) -> None:
    (own / READY).write_text(_fingerprint(wheel), encoding="utf-8")


def _fingerprint(wheel: Path) -> str:
    return hashlib.sha256(wheel.read_bytes()).hexdigest()


def _command(path: Path) -> list[str]:
    return [str(path)] if path.stem == "rtdenoise" else [str(path), "-m", "rtdenoise"]


def _works(command: list[str]) -> bool:
    """Whether the command is an rtdenoise that is new enough."""
    try:
        help_text = subprocess.run(
            [*command, "denoise", "--help"], capture_output=True, timeout=60, env=clean_environment(), check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return help_text.returncode == 0 and b"--surfaces" in help_text.stdout


def _about_venv(lines: list[str]) -> str:
    return f"no Python environment could be made: {last_line(lines)}; {CHOOSE}"


def _about_pip(lines: list[str]) -> str:
    if any(word in line for line in lines for word in OFFLINE_WORDS):
        return f"pip found no way to the internet: connect and click again, or {CHOOSE}"
    return f"pip failed: {last_line(lines)}"
