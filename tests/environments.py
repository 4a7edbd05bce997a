"""The wheel, installed into fresh virtual environments with only its requirements."""

import importlib.util
import os
import shutil
import subprocess
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent
BLENDER, BLENDER_NEEDS = "bpy==4.2.0", "3.11"  # the oldest that the add-on serves
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
LONGEST = 900  # seconds of a command: one that hangs must not take the whole run with it


def run(*command, **options):
    """The output of a command. AssertionError with all of it if the command fails, TimeoutExpired if it hangs."""
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=LONGEST, **options)
    assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
    return result.stdout


def build_wheel(folder):
    quicker = ["--no-build-isolation"] if importlib.util.find_spec("hatchling") else []
    run(*PIP, "wheel", "--no-deps", *quicker, "--wheel-dir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    return path


class Environment:
    """A virtual environment with a wheel and its requirements, as `pip install 'wheel[extras]'` would make it. The
    requirements are links to the packages of this environment, so nothing is downloaded."""

    def __init__(self, folder, wheel, extras=(), also=()):
        """`also` are distributions beside those that the wheel asks for."""
        venv.create(folder, with_pip=False)
        self.folder, self.python = folder, folder / "bin" / "python"
        run(*PIP, "--python", self.python, "install", "--no-deps", wheel)
        self.site = Path(run(self.python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
        (installed,) = self.site.glob("rtdenoise-*.dist-info")
        self.requirements = set()
        for line in _requirements((installed / "METADATA").read_text()):
            self._add(Requirement(line), extras)
        for name in also:
            self._add(Requirement(name), ())

    def run(self, *words, cwd=None, **variables):
        """A program of the environment, away from the source tree. Returns its output."""
        keep = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
        program, *arguments = words
        return run(self.folder / "bin" / program, *arguments, cwd=cwd or self.folder, env=keep | variables)

    def check(self):
        """`pip check`: AssertionError where a requirement is missing or of another version."""
        return run(*PIP, "--python", self.python, "check")

    def _add(self, requirement, extras):
        """Link a requirement of a package that is installed with `extras`, and its own requirements."""
        if requirement.marker and not any(requirement.marker.evaluate({"extra": e}) for e in ("", *extras)):
            return
        name = requirement.name.lower().replace("_", "-")
        if name == "rtdenoise" or (name, *requirement.extras) in self.requirements:
            return  # an extra that asks for another: give both
        self.requirements.add((name, *requirement.extras))
        found = distribution(name)
        for top in {path.parts[0] for path in found.files if path.parts[0] not in ("..", "__pycache__")}:
            if not (self.site / top).exists():
                (self.site / top).symlink_to(found.locate_file(top))
        for line in found.requires or ():
            self._add(Requirement(line), tuple(requirement.extras))


def blender_python():
    """A Python with Blender as a module: the one that BLENDER_PYTHON names, or an environment inside this one, which is
    made the first time (0.8 GB)."""
    if chosen := os.environ.get("BLENDER_PYTHON"):
        return Path(chosen)
    folder = Path(sys.prefix) / "blender"
    python = folder / "bin" / "python"
    if not (folder / "ready").exists():
        base = shutil.which(f"python{BLENDER_NEEDS}")
        assert base, f"{BLENDER} needs Python {BLENDER_NEEDS}; BLENDER_PYTHON names a Python that has bpy"
        run(base, "-m", "venv", "--clear", "--without-pip", folder)
        run(*PIP, "--python", python, "install", "--no-compile", BLENDER)
        (folder / "ready").touch()
    return python


def _requirements(metadata):
    head = metadata.partition("\n\n")[0]
    return [line.partition(": ")[2] for line in head.splitlines() if line.startswith("Requires-Dist: ")]
