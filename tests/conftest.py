"""Shared by all tests: the same random numbers in every run, no silent skips, a GL context, pictures of failures, ops
in two implementations."""

import contextlib
import gc
import os
import random
import re
from dataclasses import replace
from pathlib import Path

# Each worker of pytest-xdist has one thread: pictures here are tiny, and threads that outnumber the processors wait ten
# times as long for each other as they work. Torch reads it when it is imported; programs that tests start inherit it.
if int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1)) > 1:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
import quicker_halves
import torch
from environments import Environment, blender_python, build_wheel
from PIL import Image
from tolerances import TOLERANCES

quicker_halves.install()
if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when Triton is imported
with contextlib.suppress(ImportError):
    import triton  # noqa: F401  (its LLVM must be loaded before that of Mesa's OpenGL, or the process crashes)

    if os.environ.get("TRITON_INTERPRET") == "1":
        import quicker_interpreter

        quicker_interpreter.install()

FAILURES = Path(__file__).parent / "failures"


def pytest_addoption(parser):
    parser.addoption("--no-skips", action="store_true", help="a skipped test fails (so it does with CI=true)")


# The files that take longest, those with few tests among them: the others fill up the time that workers would wait.
LONG = "stability", "farm", "addon", "assets", "graphed", "journeys_tools", "kills", "wheel", "metropolis", "sanitizers"


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.path.stem.removeprefix("test_") not in LONG)


def pytest_collection_finish(session):
    """What was imported stays: the garbage collector need not look through it again and again."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish(session):
    gc.unfreeze()


def _skips_fail(config):
    return config.getoption("--no-skips") or os.environ.get("CI", "").lower() in ("1", "true")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    return _failed_if_skipped(item.config, report)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    report = yield
    return _failed_if_skipped(collector.config, report)


def _failed_if_skipped(config, report):
    if report.skipped and not hasattr(report, "wasxfail") and _skips_fail(config):
        report.outcome = "failed"
        report.longrepr = f"skipped, and here nothing may be: {report.longrepr[2]}"
    return report


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The path of the weights of a tiny network."""
    from synthetic import save_tiny

    return str(save_tiny(tmp_path_factory.mktemp("model")))


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """`weights(config)`: a file of random weights whose kernels are far from even."""
    from rtdenoise.models import create, save

    folder, written = tmp_path_factory.mktemp("weights"), {}

    def write(config):
        key = config, str(config.shapes)  # which a test may make others
        if key not in written:
            torch.manual_seed(1)
            denoiser = create(config)
            for name, parameter in denoiser.named_parameters():
                if name.startswith("full_head"):
                    parameter.data.normal_()  # a fresh edge kernel is constant
                elif "head" in name:
                    parameter.data.mul_(3)
                    parameter.data[config.kernel**2 + 1 :].normal_()  # and so is a pick kernel
            written[key] = folder / f"{len(written)}.safetensors"
            save(denoiser, written[key])
        return str(written[key])

    return write


@pytest.fixture
def thin_filters(monkeypatch):
    """Networks whose pixels are written by a thin one filter albedo and normal by thin ones, too."""
    from rtdenoise.models.hybrid_config import HybridConfig, PixelShape

    whole = HybridConfig.surfaces.fget

    def surfaces(config):
        thin = config.down[0] < PixelShape.down[0]
        return {
            name: replace(shape, down=config.down, up=config.up, out=config.out) if thin else shape
            for name, shape in whole(config).items()
        }

    monkeypatch.setattr(HybridConfig, "surfaces", property(surfaces))


@pytest.fixture(autouse=True)
def seed():
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 (what libraries draw from)
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def gl():
    """The OpenGL context of the tests. Without one, tests that need it fail and name the packages to install."""
    from rtdenoise import glsl

    return glsl.default_context()


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    """The package's wheel, built once."""
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="session")
def without_torch(tmp_path_factory, wheel):
    """The wheel in an environment of its own, as `pip install rtdenoise` leaves it."""
    return Environment(tmp_path_factory.mktemp("plain") / "venv", wheel)


@pytest.fixture(scope="session")
def with_torch(tmp_path_factory, wheel):
    """... as `pip install rtdenoise[torch] mitsuba` leaves it."""
    return Environment(tmp_path_factory.mktemp("torch") / "venv", wheel, ("torch",), also=("mitsuba",))


@pytest.fixture(scope="session")
def blender():
    """A Python with Blender as a module."""
    return blender_python()


@pytest.fixture
def assert_images_close(request):
    """`assert_images_close(result, reference, "row of tolerances.py")` for arrays or tensors of one shape.

    On failure tests/failures/<test>/ holds both and their difference: values.npz, and for [B, C, H, W] with 1 or 3
    channels PNGs of the first image, on one scale.
    """

    def check(result, reference, tolerance):
        result, reference = np.asarray(result), np.asarray(reference)
        assert result.shape == reference.shape, f"shape {result.shape}, expected {reference.shape}"
        relative, absolute = TOLERANCES[tolerance]
        difference = np.abs(result.astype(np.float64) - reference)
        wrong = ~(difference <= absolute + relative * np.abs(reference))  # NaN is wrong
        if wrong.any():
            folder = FAILURES / re.sub(r"[^\w.-]+", "_", request.node.name)
            _leave(folder, {"result": result, "reference": reference, "difference": difference})
            at = tuple(int(i) for i in np.argwhere(wrong)[0])
            pytest.fail(
                f"{wrong.sum()} of {wrong.size} values are not within '{tolerance}' (relative {relative}, absolute "
                f"{absolute}); the first at {list(at)}: {result[at]}, expected {reference[at]}. See {folder}"
            )

    return check


@pytest.fixture
def backend(request):
    """A folder of fused ops, `native` unless the test names another, and the device of its tensors."""
    folder = getattr(request, "param", "native")
    return folder, "cuda" if folder == "triton" and torch.cuda.is_available() else "cpu"


@pytest.fixture
def two_threads():
    """For kernels that share their work out: two threads, however many processors there are."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def both(backend, two_threads, monkeypatch):
    """`both(op, *arguments)`: the results of the plain op and of the fused one, on two threads."""
    from rtdenoise import ops
    from rtdenoise.ops import dispatch

    folder, device = backend
    monkeypatch.setattr(dispatch, "backend", lambda _: (folder, None))

    def run(op, *arguments):
        with ops.use("plain"):
            plain = op(*_map(torch.clone, arguments))
        with ops.use("fused"):
            fused = op(*_map(lambda t: t.detach().to(device), arguments))
        return plain, _map(torch.Tensor.cpu, fused)

    return run


def _map(function, value):
    if isinstance(value, tuple):
        return tuple(_map(function, v) for v in value)
    return function(value) if isinstance(value, torch.Tensor) else value


def _leave(folder, images):
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "values.npz", **images)
    if images["reference"].ndim == 4 and images["reference"].shape[1] in (1, 3):
        scale = max(float(np.nanmax(np.abs(images["reference"]))), 1e-12)
        for name, image in images.items():
            picture = np.nan_to_num(image[0].astype(np.float64) / scale, nan=1, posinf=1, neginf=0).clip(0, 1)
            picture = np.broadcast_to(np.moveaxis(picture, 0, -1), (*picture.shape[1:], 3))
            Image.fromarray((picture ** (1 / 2.2) * 255).round().astype(np.uint8)).save(folder / f"{name}.png")
