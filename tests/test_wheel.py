"""The wheel, installed away from the source tree: shaders, weights and the command have to come with it."""

import importlib.util
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def run(*command, **options):
    result = subprocess.run(command, capture_output=True, text=True, **options)
    assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    quicker = ["--no-build-isolation"] if importlib.util.find_spec("hatchling") else []
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    run(*pip, "wheel", "--no-deps", *quicker, "--wheel-dir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    run(*pip, "install", "--no-deps", "--target", folder / "site", path)
    return path


def python(wheel, code):
    """Run `code` where only the installed wheel can be imported, not the source tree."""
    site = wheel.parent / "site"
    start = f"import sys; sys.path[:] = [{str(site)!r}] + [p for p in sys.path if p != {str(ROOT)!r}]\n"
    return run(sys.executable, "-I", "-c", start + code, cwd=wheel.parent).strip()


def test_wheel_holds_the_package_its_shaders_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    shaders = [path.relative_to(ROOT).as_posix() for path in (ROOT / "shaders").rglob("*.glsl")]
    assert {f"rtdenoise/{name}" for name in shaders} <= set(names)
    assets = [path.relative_to(ROOT).as_posix() for path in (ROOT / "rtdenoise" / "report" / "assets").iterdir()]
    assert "rtdenoise/report/assets/report.html" in assets and set(assets) <= set(names)
    assert {name.split("/")[0].partition("-")[0] for name in names} == {"rtdenoise"}


def test_the_source_archive_is_all_that_the_tests_and_the_readme_need(tmp_path):
    quicker = ["--no-isolation"] if importlib.util.find_spec("hatchling") else []
    run(sys.executable, "-m", "build", "--sdist", *quicker, "--outdir", tmp_path, ROOT)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as content:
        names = {name.partition("/")[2] for name in content.getnames()}
    tracked = run("git", "-C", ROOT, "ls-files").split("\n") if (ROOT / ".git").exists() else ["Makefile"]
    missing = [name for name in tracked if name and name not in names and not name.startswith(".")]
    assert not missing


def test_shaders_run_from_the_wheel(wheel):
    code = """
import numpy as np
from rtdenoise import glsl
from rtdenoise.glsl.source import shaders
print(shaders())
assert glsl.apply_kernel(np.ones((1, 3, 4, 5)), np.zeros((1, 25, 4, 5))).shape == (1, 3, 4, 5)
"""
    assert python(wheel, code) == str(wheel.parent / "site" / "rtdenoise" / "shaders")


def test_weights_come_with_the_wheel(wheel):
    shipped = sorted(
        path.name.removesuffix(".safetensors") for path in (ROOT / "rtdenoise/weights").glob("*.safetensors")
    )
    code = "from rtdenoise import models\nprint(*[name for name in models.available() if models.load(name)])"
    assert python(wheel, code).split() == shipped


def test_the_command_explains_itself(wheel):
    code = """
from importlib.metadata import entry_points
(command,) = {entry for entry in entry_points(group="console_scripts", name="rtdenoise")}
sys.argv = ["rtdenoise", "--help"]
command.load()()
"""
    assert "denoise" in python(wheel, code)
