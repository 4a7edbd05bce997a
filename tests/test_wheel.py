"""The wheel, installed away from the source tree: shaders, weights and the command have to come with it."""

import importlib.util
import sys
import tarfile
import zipfile

from environments import ROOT, run


def test_wheel_holds_the_package_its_shaders_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    shaders = [path.relative_to(ROOT).as_posix() for path in (ROOT / "shaders").rglob("*.glsl")]
    assert {f"rtdenoise/{name}" for name in shaders} <= set(names)
    assets = [path.relative_to(ROOT).as_posix() for path in (ROOT / "rtdenoise" / "report" / "assets").iterdir()]
    assert "rtdenoise/sample/mural-window/frame.0008.exr" in names
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


def test_the_requirements_are_complete_with_torch_and_without(without_torch, with_torch):
    without_torch.check()
    with_torch.check()
    names = {name for name, *_ in without_torch.requirements}
    assert {"numpy", "moderngl", "openexr", "safetensors"} <= names and not names & {"torch", "scikit-image", "scipy"}
    assert {"torch", "scikit-image"} <= {name for name, *_ in with_torch.requirements}


def test_shaders_run_from_the_wheel(without_torch):
    code = """
import numpy as np
from rtdenoise import glsl
from rtdenoise.glsl.source import shaders
print(shaders())
assert glsl.apply_kernel(np.ones((1, 3, 4, 5)), np.zeros((1, 25, 4, 5))).shape == (1, 3, 4, 5)
"""
    assert without_torch.run("python", "-c", code).strip() == str(without_torch.site / "rtdenoise" / "shaders")


def test_weights_come_with_the_wheel(with_torch):
    shipped = sorted(
        path.name.removesuffix(".safetensors") for path in (ROOT / "rtdenoise/weights").glob("*.safetensors")
    )
    code = (
        "from rtdenoise import models\n"
        "found = [name for name in models.available() if models.load(name)]\n"
        "found += [name for name in models.available_combiners() if models.load_combiner(name)]\n"
        "[models.load(name, precision='int8') for name in ('default', 'hybrid', 'hybrid-fast')]\n"
        "print(*found)"
    )
    assert sorted(with_torch.run("python", "-c", code).split()) == shipped


def test_the_command_explains_itself(without_torch):
    assert "denoise" in without_torch.run("rtdenoise", "--help")
