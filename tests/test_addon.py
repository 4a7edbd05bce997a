"""The Blender add-on: its zip, its journey inside Blender, and its parts that need no Blender."""

import json
import os
import re
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from environments import ROOT, run

from rtdenoise.data.exr import read_channels, read_header

ADDON = ROOT / "examples" / "blender" / "addon"
sys.path.insert(0, str(ROOT / "tools"))

import addon as builder  # noqa: E402


@pytest.fixture(scope="module")
def parts():
    """The add-on's modules that call no bpy when they are imported, as a package would."""
    import importlib.util
    import types

    package = types.ModuleType("addon_parts")
    package.__path__ = [str(ADDON)]
    sys.modules["addon_parts"] = package
    found = {}
    sys.modules.setdefault("bpy", types.ModuleType("bpy"))
    for name in ("process", "environment", "work"):
        spec = importlib.util.spec_from_file_location(f"addon_parts.{name}", ADDON / f"{name}.py")
        found[name] = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(found[name])
    return found


@pytest.fixture
def operators(parts, monkeypatch):
    """The add-on's operators: the other modules that they use stand in for themselves, and bpy has an empty class."""
    import importlib.util
    import types

    monkeypatch.setattr(sys.modules["bpy"], "types", types.SimpleNamespace(Operator=object), raising=False)
    for name in ("compositor", "passes"):
        stand_in = types.ModuleType(f"addon_parts.{name}")
        monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
        monkeypatch.setattr(sys.modules["addon_parts"], name, stand_in, raising=False)
    spec = importlib.util.spec_from_file_location("addon_parts.operators", ADDON / "operators.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def zipped(wheel, tmp_path_factory):
    return builder.build(wheel, tmp_path_factory.mktemp("zip"))


def wait(job):
    while job.poll():
        time.sleep(0.01)


def stage(parts, code, **options):
    explain = options.pop("explain", lambda lines: f"failed: {lines[-1]}")
    return parts["process"].Stage("Counting", [sys.executable, "-u", "-c", code], explain, **options)


# --- the zip ----------------------------------------------------------------------------------------------------------


def test_the_zip_is_an_extension_with_rtdenoise_in_it(zipped, wheel):
    names = zipfile.ZipFile(zipped).namelist()
    assert {"blender_manifest.toml", "__init__.py", "render_frames.py", wheel.name} <= set(names)
    assert {path.name for path in ADDON.glob("*.py")} <= set(names) and not any("/" in name for name in names)


def test_the_manifest_is_as_blender_wants_it():
    manifest = tomllib.loads((ADDON / "blender_manifest.toml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest["version"] == project["version"] and manifest["blender_version_min"] == "4.2.0"
    texts = [manifest["tagline"], *manifest["permissions"].values()]
    assert all(len(text) <= 64 and text[-1].isalnum() for text in texts)


# --- inside Blender ---------------------------------------------------------------------------------------------------


def test_an_artist_installs_clicks_cancels_and_continues(zipped, blender, with_torch, tmp_path):
    keep = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    settings = {"BLENDER_USER_RESOURCES": str(tmp_path / "settings"), "PATH": "/usr/bin:/bin"}
    (tmp_path / "settings").mkdir()
    script = Path(__file__).parent / "journeys" / "blender_addon.py"
    python = with_torch.folder / "bin" / "python"
    printed = run(blender, script, zipped, python, tmp_path, cwd=tmp_path, env=keep | settings)
    assert len(re.findall("^refused: ", printed, re.M)) == 12, printed
    noisy = tmp_path / "denoised" / "Scene" / "noisy" / "frame.0001.exr"
    for name in ("passes.exr", "best.exr"):
        assert read_header(tmp_path / name).channels.keys() == read_header(noisy).channels.keys()
        grainy, clean = (graininess(path) for path in (noisy, tmp_path / name))
        assert clean < 0.7 * grainy, (name, clean, grainy)


def test_what_a_file_sets_spoils_no_frames_of_render_py(blender, tmp_path):
    renderer = ROOT / "examples" / "blender" / "render.py"
    run(blender, Path(__file__).parent / "journeys" / "blender_spoiled.py", tmp_path)
    run(blender, renderer, tmp_path / "shot", "--scene", tmp_path / "spoiled.blend")
    paths = sorted((tmp_path / "shot").iterdir())
    assert [path.name for path in paths] == ["frame.0001.exr", "frame.0002.exr"]
    for path in paths:
        header = read_header(path)
        assert (header.width, header.height, header.samples) == (32, 24, 1)
        assert {name.split(".")[0] for name in header.channels} == {"first"}
        assert "first.Combined.R" in header.channels and "first.Vector.X" in header.channels
        assert read_channels(path, ["first.Combined.R"])["first.Combined.R"].min() > 0, "the whole picture"
    for name, words in (("blind.blend", "has no camera"), ("missing.blend", "no such file")):
        done = subprocess.run([blender, renderer, tmp_path / "no", "--scene", tmp_path / name], capture_output=True)
        assert done.returncode == 2 and words in done.stderr.decode().splitlines()[-1]


def test_physics_fall_as_they_do_in_blender_also_after_a_cancelled_job(blender, tmp_path):
    run(blender, Path(__file__).parent / "journeys" / "blender_cloth.py", tmp_path)
    frames = [tmp_path / "noisy" / f"frame.{number:04d}.exr" for number in range(1, 9)]
    render = (blender, ADDON / "render_frames.py", tmp_path / "cloth.blend", "--", tmp_path / "job.json")
    run(*render)
    whole = depths(frames)
    for path in frames[4:]:
        path.unlink()
    run(*render)
    assert depths(frames) == whole
    run(blender, ROOT / "examples" / "blender" / "render.py", tmp_path / "shot", "--scene", tmp_path / "cloth.blend")
    assert depths(sorted((tmp_path / "shot").iterdir())) == pytest.approx(whole, rel=1e-5)
    assert whole == pytest.approx(json.loads((tmp_path / "played.json").read_text()), rel=1e-3)


def depths(paths):
    """Of the point in the middle of each frame."""
    planes = (read_channels(path, ["ViewLayer.Depth.Z"])["ViewLayer.Depth.Z"] for path in paths)
    return [float(plane[plane.shape[0] // 2, plane.shape[1] // 2]) for plane in planes]


def graininess(path):
    """Mean difference of neighbours in Combined, relative to its mean."""
    image = np.stack(list(read_channels(path, [f"ViewLayer.Combined.{c}" for c in "RGB"]).values()))
    assert np.isfinite(image).all()
    return float(np.abs(np.diff(image, axis=2)).mean() / image.mean())


# --- without Blender --------------------------------------------------------------------------------------------------


def test_a_job_counts_and_does_what_comes_after(parts, tmp_path):
    go = str(tmp_path / "go")
    code = f"import os, time; print('1/3'); print('more')\nwhile not os.path.exists({go!r}): time.sleep(.01)"
    job = parts["process"].Job([stage(parts, code), stage(parts, "", after=(tmp_path / "after").touch)])
    while job.poll() and not job.total:
        assert job.text == "Counting …"
        time.sleep(0.01)
    assert job.text == "Counting 1/3" and job.fraction == pytest.approx(1 / 3)
    (tmp_path / "go").touch()
    wait(job)
    assert (tmp_path / "after").exists()


def test_what_a_program_prints_is_read_whatever_the_systems_encoding(parts):
    said, plain = [], {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}  # a pipe has ASCII then
    failing = stage(parts, r"print('Stra\u00dfe.exr'); raise SystemExit(1)", explain=said.extend, environment=plain)
    with pytest.raises(parts["process"].Trouble):
        wait(parts["process"].Job([failing]))
    assert said == ["Straße.exr"]


def test_a_stage_that_fails_ends_the_job_in_a_sentence(parts, tmp_path):
    trouble = parts["process"].Trouble
    job = parts["process"].Job([stage(parts, "print('why'); raise SystemExit(3)"), stage(parts, "")])
    with pytest.raises(trouble, match="failed: why"):
        wait(job)
    assert not job.poll()
    optional = stage(parts, "raise SystemExit(1)", optional=True, after=(tmp_path / "never").touch)
    wait(parts["process"].Job([optional, stage(parts, "", after=(tmp_path / "last").touch)]))
    assert (tmp_path / "last").exists() and not (tmp_path / "never").exists()
    with pytest.raises(trouble, match="does not start"):
        wait(parts["process"].Job([parts["process"].Stage("", ["/no/such/program"], str)]))


def test_cancel_ends_the_whole_group(parts, tmp_path):
    child = f"import time, pathlib; time.sleep(1.5); pathlib.Path({str(tmp_path / 'late')!r}).touch()"
    start = f"subprocess.Popen([sys.executable, '-c', {child!r}])"
    code = f"import subprocess, sys, time; {start}; print('1/2'); time.sleep(9)"
    job = parts["process"].Job([stage(parts, code), stage(parts, "", after=(tmp_path / "next").touch)])
    while job.poll() and not job.done:
        time.sleep(0.01)
    started = time.monotonic()
    job.cancel()
    assert time.monotonic() - started < 4 and not job.poll()
    time.sleep(1.7)
    assert not (tmp_path / "late").exists() and not (tmp_path / "next").exists()


@pytest.mark.parametrize("fails", ["job", "finished", "cleared"])
def test_what_blender_raises_ends_the_job_in_a_sentence(operators, parts, fails):
    """A job that went on for ever kept all others from beginning."""
    from types import SimpleNamespace

    said = []

    class Operator(operators.Watched):
        def report(self, kind, sentence):
            said.append((kind, sentence))

        def job(self, context):
            if fails == "job":
                raise RuntimeError("Error: no space left\n")
            return parts["process"].Job([])

        def finished(self, context):
            raise RuntimeError("Error: no space left\n")

        def cleared(self):
            if fails == "cleared":
                raise PermissionError(13, "Permission denied")

    context = SimpleNamespace(window_manager=SimpleNamespace(windows=()))
    assert Operator().execute(context) == {"CANCELLED"}
    assert operators.running is None and operators.message == "Error: no space left"
    assert said == [({"ERROR"}, "Error: no space left")]


@pytest.mark.parametrize("text, names", [
    ("", ()), ("Combined_key Combined_fill", ("Combined_key", "Combined_fill")), ("a,b , c", ("a", "b", "c")),
    ("Combined_key light, Combined_fill", ("Combined_key light", "Combined_fill")),
    ("Shadow  Catcher,Combined_key b", ("Shadow Catcher", "Combined_key", "b")),
])  # fmt: skip
def test_names_of_passes_may_hold_spaces(parts, text, names):
    from types import SimpleNamespace

    groups = [SimpleNamespace(name=name) for name in ("key light", "fill")]
    layer = SimpleNamespace(lightgroups=groups, aovs=[SimpleNamespace(name="a")])
    assert parts["work"].also_of(text, parts["work"].additive(layer)) == names


def test_frames_go_by_their_numbers(parts, tmp_path):
    made = parts["work"].Work("", "", 1, -2, 10000, "BEST", (), "", "", str(tmp_path))
    numbers = [-2, 7, 9999, 10000]
    for number in numbers:
        (tmp_path / f"frame.{number:04d}.exr").touch()
    assert [int(path.name.split(".")[1]) for path in parts["work"].clean_frames(made)] == numbers


@pytest.mark.parametrize("links", [True, False])
def test_a_copy_shares_the_physics_baked_to_disk(parts, tmp_path, monkeypatch, links):
    work, file, copy = parts["work"], tmp_path / "film.blend", tmp_path / "job" / "job.blend"
    if not links:
        monkeypatch.setattr(Path, "symlink_to", lambda *_, **__: (_ for _ in ()).throw(OSError))
    copy.parent.mkdir()
    work.share_cache(file, copy)
    assert not any(copy.parent.iterdir())
    baked = tmp_path / "blendcache_film" / "cloth_000001_00.bphys"
    baked.parent.mkdir()
    baked.write_text("baked")
    for _ in range(2):  # a job after a job
        work.share_cache(file, copy)
        assert (tmp_path / "job" / "blendcache_job" / baked.name).read_text() == "baked"
    work.forget_cache(copy)
    assert not any(copy.parent.iterdir()) and baked.exists()


def test_a_job_begins_anew_where_an_offline_one_was_cancelled(parts, tmp_path):
    """Which leaves the first pass's estimates in a folder beside the frames."""
    for name in ("frame.0001.exr", "denoise.json", ".rtdenoise-state.safetensors", ".rtdenoise-forward/0.npy", "notes"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    parts["work"].remove_frames(tmp_path, tmp_path / "nothing")
    assert [path.name for path in tmp_path.iterdir()] == ["notes"]


def test_a_python_with_rtdenoise_is_found(parts, tmp_path, monkeypatch):
    environment = parts["environment"]
    own = tmp_path / "own"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert environment.find("", own) is None
    for name in (environment.PYTHON, environment.READY):
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        (own / name).touch()
    assert environment.find("", own) == [str(own / environment.PYTHON), "-m", "rtdenoise"]
    (own / environment.READY).unlink()
    assert environment.find("", own) is None, "an installation that did not end well"
    program = tmp_path / "rtdenoise"
    program.write_text("#!/bin/sh\necho 'usage: --surfaces'\n")
    program.chmod(0o755)
    assert environment.find("", own) == [str(program)] == environment.find(str(program), own)
    program.write_text("#!/bin/sh\necho 'usage: an older one'\n")
    assert environment.find("", own) is None


def test_an_environment_is_made_by_blenders_python(parts, wheel, tmp_path, monkeypatch):
    """The same stages, with pip kept from the network: only the wheel itself is installed, so trying it fails."""
    environment, own = parts["environment"], tmp_path / "own"
    monkeypatch.setenv("PIP_NO_DEPS", "1")
    stages = environment.stages_to_make(own, wheel, "", online=True)
    assert [s.label for s in stages if s.optional] == ["Downloading OIDN"]
    with pytest.raises(parts["process"].Trouble, match="pip failed: ModuleNotFoundError: No module named"):
        wait(parts["process"].Job([s for s in stages if not s.optional]))
    assert run(own / environment.PYTHON, "-m", "pip", "list").count("rtdenoise") == 1
    assert not (own / environment.READY).exists()


def test_an_environment_of_another_wheel_is_brought_up_to_date(parts, tmp_path, monkeypatch):
    """As after an update of the add-on; PyTorch stays, and nothing is downloaded where that is not allowed."""
    environment, own, wheel = parts["environment"], tmp_path / "own", tmp_path / "rtdenoise.whl"
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in (environment.PYTHON, environment.READY):
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        (own / name).touch()
    for content in (b"new", b"newer"):
        wheel.write_bytes(content)
        assert environment.find("", own, wheel) is None
        update, *others = environment.stages_to_make(own, wheel, "", online=False)
        assert update.command[-3:] == ["--force-reinstall", "--no-deps", str(wheel)]
        assert [stage.label for stage in others] == ["Trying rtdenoise"]
        others[-1].after()
        assert environment.find("", own, wheel) == [str(own / environment.PYTHON), "-m", "rtdenoise"]
    assert len(environment.stages_to_make(own, wheel, "", online=True)) == 3


@pytest.mark.parametrize(("options", "words"), [
    ({"online": False}, "allow online access"), ({"base": ""}, "Blender came without Python"),
    ({"wheel": None}, "lacks rtdenoise"),
])  # fmt: skip
def test_without_what_it_takes_no_environment_is_begun(parts, tmp_path, options, words):
    with pytest.raises(parts["process"].Trouble, match=words):
        usual = {"own": tmp_path, "wheel": tmp_path, "index": "", "online": True}
        parts["environment"].stages_to_make(**usual | options)
