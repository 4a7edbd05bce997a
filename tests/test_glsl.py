"""Compute shaders against their torch twins, on any OpenGL 4.3 (in CI Mesa's llvmpipe)."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from rtdenoise import constants, glsl, ops
from rtdenoise.errors import InputError
from rtdenoise.glsl import GpuArray, ShaderError
from rtdenoise.glsl.dispatch import dispatch
from rtdenoise.glsl.program import program
from rtdenoise.glsl.source import expand, locate

SIZES = [(1, 1), (1, 9), (17, 5), (48, 64)]  # (H, W)


@pytest.fixture(autouse=True)
def no_gl_error(gl):
    yield
    assert gl.error == "GL_NO_ERROR"


def on_gpu(gl, function, *arrays, shape, **options):
    """The form for `GpuArray`s, writing into a buffer full of NaN."""
    out = GpuArray.upload(gl, np.full(shape, np.nan))
    result = function(*(GpuArray.upload(gl, a, a.dtype) for a in arrays), **options, out=out)
    assert result is out
    return result.read()


def torch_twin(function, *arrays, **options):
    return function(*(torch.from_numpy(a) for a in arrays), **options).numpy()


def random(*shape):
    return torch.rand(shape).numpy()


# apply_kernel


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("tap", range(25))
def test_apply_kernel_of_one_lit_pixel(gl, tap, dtype):
    image, logits = np.zeros((1, 1, 9, 13), np.float32), np.full((1, 25, 9, 13), -1e4, dtype)
    image[0, 0, 4, 7] = 1
    logits[:, tap] = 0
    out = on_gpu(gl, glsl.apply_kernel, image, logits, shape=image.shape)
    # out[y, x] = image[y + dy - 2, x + dx - 2]: the lit pixel appears where that is (4, 7).
    dy, dx = divmod(tap, 5)
    assert np.argwhere(out > 0.5).tolist() == [[0, 0, 6 - dy, 9 - dx]]
    assert out.sum() == pytest.approx(1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kernel", [3, 5])
@pytest.mark.parametrize("channels", [1, 3])
def test_apply_kernel_is_its_torch_twin(gl, assert_images_close, size, kernel, channels):
    image, logits = random(2, channels, *size), 16 * random(2, kernel**2, *size) - 8
    expected = torch_twin(ops.apply_kernel, image, logits)
    assert_images_close(on_gpu(gl, glsl.apply_kernel, image, logits, shape=image.shape), expected, "float32")
    assert_images_close(glsl.apply_kernel(image, logits), expected, "float32")

    half = logits.astype(np.float16)
    result = on_gpu(gl, glsl.apply_kernel, image, half, shape=image.shape)
    assert_images_close(result, torch_twin(ops.apply_kernel, image, half), "float32")
    assert_images_close(result, expected, "float16 logits")


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_apply_kernel_with_extreme_logits(gl, assert_images_close, dtype):
    image = random(1, 3, 8, 13)
    for logits in (
        np.full((1, 25, 8, 13), 1e4, dtype),
        np.full((1, 25, 8, 13), -1e4, dtype),
        np.where(random(1, 25, 8, 13) < 0.5, -1e4, 1e4).astype(dtype),
    ):
        out = on_gpu(gl, glsl.apply_kernel, image, logits, shape=image.shape)
        assert_images_close(out, torch_twin(ops.apply_kernel, image, logits), "float32")


def test_apply_kernel_keeps_constants_whatever_lies_outside(gl, assert_images_close):
    image, logits = np.full((1, 3, 6, 7), 0.7, np.float32), np.zeros((1, 25, 6, 7), np.float32)
    logits[:, 0] = 1e4  # at the top and on the left this tap is outside, and must not swallow the rest
    assert_images_close(glsl.apply_kernel(image, logits), image, "float32")


def test_apply_kernel_takes_strided_and_double_input(assert_images_close):
    image, logits = (random(1, 8, 9, c).transpose(0, 3, 1, 2).astype(np.float64) for c in (3, 25))
    expected = torch_twin(ops.apply_kernel, image, logits)
    assert_images_close(glsl.apply_kernel(image, logits), expected, "float32")


@pytest.mark.parametrize("rows", [1, 5, 11, 12, 40])
def test_apply_kernel_in_bands_of_rows(monkeypatch, rows):
    image, logits = random(2, 3, 13, 8), random(2, 25, 13, 8)
    whole = glsl.apply_kernel(image, logits)
    monkeypatch.setattr("rtdenoise.glsl.ops.storage_limit", lambda ctx: rows * 2 * 25 * 8 * 4)
    assert np.array_equal(glsl.apply_kernel(image, logits), whole)


# The other passes


@pytest.mark.parametrize("shape", [(0, 4, 6), (1, 0, 6), (1, 4, 0)])  # B, H, W
def test_empty_arrays_stay_empty(gl, shape):
    B, H, W = shape

    def empty(channels):
        return np.zeros((B, channels, H, W), np.float32)

    for op, channels in (("apply_kernel", (3, 25)), ("warp", (3, 2)), ("fetch", (3, 2)), ("blend", (3, 3, 1))):
        images = [empty(c) for c in channels]
        found = getattr(glsl, op)(*images)
        assert found.shape == torch_twin(getattr(ops, op), *images).shape and found.dtype == np.float32
    surface = empty(1), empty(3)
    found, valid = glsl.reproject(empty(3), empty(2), surface, surface)
    assert found.shape == (B, 3, H, W) and valid.shape == (B, 1, H, W) and valid.dtype == bool


@pytest.mark.parametrize("size", SIZES)
def test_warp_and_fetch_are_their_torch_twins(gl, assert_images_close, size):
    image, motion = random(2, 3, *size), 12 * random(2, 2, *size) - 6
    for bad in (np.nan, np.inf, -np.inf, 1e30):
        motion[np.unravel_index(torch.randint(motion.size, ()).item(), motion.shape)] = bad
    for name, tolerance in (("warp", "float32"), ("fetch", "exact")):
        out = on_gpu(gl, getattr(glsl, name), image, motion, shape=image.shape)
        assert_images_close(out, torch_twin(getattr(ops, name), image, motion), tolerance)
    cubic = on_gpu(gl, glsl.warp, image, motion, cubic=True, shape=image.shape)
    assert_images_close(cubic, torch_twin(ops.warp, image, motion, cubic=True), "float32")
    whole = np.round(motion)
    for way in (False, True):
        out = glsl.warp(image, whole, cubic=way)
        assert_images_close(out, torch_twin(ops.warp, image, whole, cubic=way), "exact")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("pool", ["mean", "max"])
def test_downsample_and_compose_are_their_torch_twins(gl, assert_images_close, size, pool):
    coarse_size = tuple((n + 1) // 2 for n in size)
    fine, coarse, alpha = random(2, 3, *size) - 0.5, random(2, 3, *coarse_size), random(2, 1, *coarse_size)
    down = on_gpu(gl, glsl.downsample, fine, pool=pool, shape=coarse.shape)
    assert_images_close(down, torch_twin(ops.downsample, fine, pool=pool), "float32")
    composed = on_gpu(gl, glsl.compose, fine, coarse, alpha, pool=pool, shape=fine.shape)
    assert_images_close(composed, torch_twin(ops.compose, fine, coarse, alpha, pool=pool), "float32")


@pytest.mark.parametrize("size", SIZES)
def test_soften_is_its_torch_twin(gl, assert_images_close, size):
    inputs = random(2, 3, *size), random(2, 3, *size), random(2, 1, *size)
    softened = on_gpu(gl, glsl.soften, *inputs, shape=inputs[0].shape)
    assert_images_close(softened, torch_twin(ops.soften, *inputs), "float32")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kernel", [1, 3, 5])
def test_pick_is_its_torch_twin(gl, assert_images_close, size, kernel):
    fine, coarse, share = random(2, 3, *size), random(2, 3, *((n + 1) // 2 for n in size)), random(2, 1, *size)
    logits = 16 * random(2, kernel**2, *size) - 8
    for given in (logits, logits.astype(np.float16)):
        picked = on_gpu(gl, glsl.pick, fine, coarse, given, share, shape=fine.shape)
        assert_images_close(picked, torch_twin(ops.pick, fine, coarse, given, share), "float32")


@pytest.mark.parametrize("size", SIZES)
def test_upsample_and_blend_are_their_torch_twins(gl, assert_images_close, size):
    coarse = random(2, 3, *((n + 1) // 2 for n in size))
    up = on_gpu(gl, glsl.upsample, coarse, size=size, shape=(2, 3, *size))
    assert_images_close(up, torch_twin(ops.upsample, coarse, size=size), "float32")
    spatial, temporal, alpha = random(2, 3, *size), random(2, 3, *size), random(2, 1, *size)
    blended = on_gpu(gl, glsl.blend, spatial, temporal, alpha, shape=spatial.shape)
    assert_images_close(blended, torch_twin(ops.blend, spatial, temporal, alpha), "float32")


@pytest.mark.parametrize("size", SIZES)
def test_alike_and_reproject_are_their_torch_twins(gl, assert_images_close, size):
    def surface():
        depth = np.where(random(2, 1, *size) < 0.2, 0, 1 + 0.15 * random(2, 1, *size)).astype(np.float32)
        return depth, 2 * random(2, 3, *size) - 0.6

    here, before = surface(), surface()
    expected = torch_twin(lambda a, b, c, d: ops.alike((a, b), (c, d)), *here, *before)
    assert np.array_equal(glsl.alike(here, before), expected)
    resident = on_gpu(gl, lambda a, b, c, d, out: glsl.alike((a, b), (c, d), out=out), *here, *before,
                      shape=expected.shape)  # fmt: skip
    assert np.array_equal(resident > 0, expected)

    stored, motion = random(2, 7, *size), 6 * random(2, 2, *size) - 3
    for bad in (np.nan, np.inf, -np.inf, 1e30):
        motion[np.unravel_index(torch.randint(motion.size, ()).item(), motion.shape)] = bad
    tensors = [torch.from_numpy(array) for array in (stored, motion, *here, *before)]
    image, valid = ops.reproject(*tensors[:2], tuple(tensors[2:4]), tuple(tensors[4:]))
    found, found_valid = glsl.reproject(stored, motion, here, before)
    assert np.array_equal(found_valid, valid.numpy())
    assert_images_close(found, image, "float32")
    stored[before[0].repeat(7, axis=1) == 0] = np.inf  # taps without weight are not read
    image, _ = ops.reproject(torch.from_numpy(stored), *tensors[1:2], tuple(tensors[2:4]), tuple(tensors[4:]))
    found, _ = glsl.reproject(stored, motion, here, before)
    assert np.array_equal(np.isfinite(found), image.isfinite().numpy())


def test_every_operation_has_a_twin():
    torch_alone = {"use", "attend_channels"}  # a switch; an op of networks without shaders
    assert set(ops.__all__) - torch_alone <= set(glsl.__all__)


def test_what_does_not_fit_is_named(gl):
    image, logits = random(1, 3, 4, 5), random(1, 25, 4, 5)
    resident = GpuArray.upload(gl, image)
    with pytest.raises(ValueError, match=r"expected logits .*got \(1, 24, 4, 5\)"):
        glsl.apply_kernel(image, logits[:, :24])
    with pytest.raises(ValueError, match=r"K odd, got \(1, 4, 4, 5\)"):
        glsl.apply_kernel(image, logits[:, :4])
    with pytest.raises(ValueError, match=r"expected motion \(1, 2, 4, 5\), got \(1, 25, 4, 5\)"):
        glsl.warp(image, logits)
    with pytest.raises(ValueError, match="both"):
        glsl.apply_kernel(resident, logits)
    with pytest.raises(ValueError, match="none of the inputs"):
        glsl.apply_kernel(resident, GpuArray.upload(gl, logits), out=resident)
    with pytest.raises(ValueError, match="expected float32, got float16"):
        glsl.downsample(GpuArray.upload(gl, image, np.float16))


# Buffers and the context


def test_an_array_that_is_too_large_is_named(gl):
    rows = 1 + glsl.storage_limit(gl) // (51 * 1280 * 4)
    with pytest.raises(InputError, match=rf"\[1, 51, {rows}, 1280\] float32 is .* MB, but .* MB .*float16"):
        GpuArray.empty(gl, (1, 51, rows, 1280))


def test_half_arrays_of_odd_length_come_back(gl):
    values = random(1, 3, 5, 7).astype(np.float16)
    assert np.array_equal(GpuArray.upload(gl, values, np.float16).read(), values)


@pytest.mark.parametrize(
    "environment, found",
    [
        ({"MESA_GL_VERSION_OVERRIDE": "3.3"}, "3.3 (llvmpipe"),
        ({"GLCONTEXT_LINUX_LIBEGL": "libnone.so"}, "none (libnone.so not loaded)"),
    ],
)
def test_without_a_driver_one_line_says_what_to_install(gl, environment, found):
    """Only Mesa can be told to have less."""
    if "Mesa" not in gl.info["GL_VERSION"] and "MESA_GL_VERSION_OVERRIDE" in environment:
        environment, found = {"GLCONTEXT_LINUX_LIBGL": "libnone.so", "GLCONTEXT_LINUX_LIBEGL": "libnone.so"}, "none ("
    script = "from rtdenoise.glsl import create_context\ntry: create_context()\nexcept ValueError as e: print(e)"
    run = subprocess.run([sys.executable, "-c", script], env=os.environ | environment, capture_output=True, text=True)
    assert run.stdout.count("\n") == 1, run.stderr
    assert found in run.stdout and "apt install libegl1" in run.stdout


# Programs


@pytest.fixture
def folder(tmp_path):
    """A folder of shaders: `folder(name=text, …)`, where `__` in a name stands for `/`."""
    (tmp_path / "include").mkdir()

    def write(**files):
        for name, text in files.items():
            (tmp_path / f"{name.replace('__', '/')}.glsl").write_text(text)
        for shader in tmp_path.glob("*.glsl"):
            shader.rename(shader.with_suffix(".comp.glsl"))
        return tmp_path

    return write


def test_programs_are_compiled_once(gl):
    first = program(gl, "ops/blend", CHANNELS=3, GROUP_X=8, GROUP_Y=8)
    assert program(gl, "ops/blend", GROUP_Y=8, GROUP_X=8, CHANNELS=3) is first
    assert program(gl, "ops/blend", CHANNELS=1, GROUP_X=8, GROUP_Y=8) is not first


def test_constants_are_strict():
    with pytest.raises(ShaderError, match=r"apply_kernel\.comp\.glsl: missing constants GROUP_X, GROUP_Y, LOGITS_HALF"):
        expand("ops/apply_kernel", KERNEL=5, CHANNELS=3)
    with pytest.raises(ShaderError, match=r"unknown constants KERNEL; it takes CHANNELS, GROUP_X, GROUP_Y"):
        expand("ops/blend", CHANNELS=3, GROUP_X=8, GROUP_Y=8, KERNEL=5)


def test_shared_constants_have_the_values_of_python():
    text = expand("frame/light", GROUP_X=8, GROUP_Y=8).text
    assert f"#define GLOSS {constants.GLOSS}\n" in text
    assert f"#define LUMINANCE_WEIGHTS vec3{constants.LUMINANCE_WEIGHTS}\n" in text
    assert "MIN_HISTORY_WEIGHT" not in text  # the shader does not ask for it


def test_buffers_are_bound_by_name(gl):
    spatial, temporal, alpha = (GpuArray.upload(gl, np.full((1, 1, 2, 2), value)) for value in (8.0, 4.0, 0.25))
    result = GpuArray.empty(gl, spatial.shape)
    named = {"alpha": alpha, "result": result, "temporal": temporal, "spatial": spatial}  # not the declared order
    dispatch("ops/blend", (2, 2), named, CHANNELS=1)
    assert (result.read() == 5).all()


def test_buffers_and_parameters_are_strict(gl):
    array = GpuArray.upload(gl, np.zeros((1, 1, 2, 2)))
    named = dict.fromkeys(("spatial", "temporal", "alpha", "result"), array)

    def refused(buffers, parameters=None):
        with pytest.raises(ShaderError) as error:
            dispatch("ops/blend", (2, 2), buffers, parameters, CHANNELS=1)
        return str(error.value)

    assert refused({"spatial": array, "result": array}) == "ops/blend.comp.glsl: missing buffers alpha, temporal"
    assert refused(named | {"beta": array}).endswith("unknown buffers beta; it takes alpha, result, spatial, temporal")
    assert refused(named, {"groups": 3}).endswith("unknown parameters groups; it takes size")
    with pytest.raises(ShaderError, match=r"frame/fill\.comp\.glsl: missing parameters value"):
        dispatch("frame/fill", (1, 1), {"values": array}, {"count": 1}, (32,), ROW=32)


def test_declarations_become_bindings_and_uniforms(folder):
    shaders = folder(
        main="#version 430\n#pragma parameters ivec2 size, int n  // (W, H)\n#pragma reads vec4 a_b\n#if N\n"
        "#pragma reads uint c\n#else\n#pragma reads float c\n#endif\n#pragma changes uint d\n#pragma constants N\n",
    )
    source = expand("main", folder=shaders, N=1)
    assert (source.buffers, source.parameters) == (("a_b", "c", "d"), ("size", "n"))
    assert "layout(push_constant) uniform Parameters { ivec2 size; int n; };" in source.text
    assert "uniform ivec2 size;\nuniform int n;\n" in source.text
    for line in (
        "layout(std430, binding = 0) readonly restrict buffer AB { vec4 a_b[]; };",
        "layout(std430, binding = 1) readonly restrict buffer C { uint c[]; };",
        "layout(std430, binding = 1) readonly restrict buffer C { float c[]; };",
        "layout(std430, binding = 2) restrict buffer D { uint d[]; };",
    ):
        assert line in source.text.splitlines()


@pytest.mark.parametrize(
    "lines, message",
    [
        ("#pragma reads image", r"main\.comp\.glsl:2: expected `#pragma reads TYPE NAME, TYPE NAME …`"),
        (
            "#pragma parameters int n\n#pragma parameters vec2 n",
            r"main\.comp\.glsl:3: parameter n is int elsewhere",
        ),
        ("\n".join(f"#pragma reads float b{i}" for i in range(9)), r"main\.comp\.glsl: 9 buffers, expected at most 8"),
    ],
)
def test_declarations_that_cannot_be_are_named(folder, lines, message):
    with pytest.raises(ShaderError, match=message):
        expand("main", folder=folder(main=f"#version 430\n{lines}\n"))


def test_includes_are_recursive_and_taken_once(folder):
    shaders = folder(
        main='#version 430\n#include "a.glsl"\n#include "b.glsl"\nmain\n',
        include__a='#include "b.glsl"\na\n',
        include__b="#pragma constants N\nb\n",
    )
    source = expand("main", folder=shaders, N=2)
    assert source.text.splitlines() == ["#version 430", "#define N 2", "", "b", "a", "main"]
    assert source.origin[2:] == ["include/b.glsl:1", "include/b.glsl:2", "include/a.glsl:2", "main.comp.glsl:4"]


def test_include_loops_and_missing_files_are_named(folder):
    shaders = folder(main='#include "a.glsl"', include__a='#include "b.glsl"', include__b='#include "a.glsl"')
    with pytest.raises(ShaderError, match=r"loop: main\.comp\.glsl → include/a\.glsl → include/b\.glsl → include/a"):
        expand("main", folder=shaders)
    with pytest.raises(ShaderError, match=r"no shader file include/none\.glsl in .*, included by main\.comp\.glsl"):
        expand("main", folder=folder(main='#include "none.glsl"'))


def test_compile_errors_name_file_and_line(gl, folder):
    shaders = folder(
        main='#version 430\n#pragma constants N\n#include "a.glsl"\nvoid main() { f(); }\n',
        include__a="layout(local_size_x = N) in;\n\nvoid f() { nothing = 1; }\n",
    )
    with pytest.raises(ShaderError, match=r"main\.comp\.glsl does not compile:(.|\n)*include/a\.glsl:3.*nothing"):
        program(gl, "main", folder=shaders, N=1)


@pytest.mark.parametrize("log", ["0:2(9): error: x", "0(2) : error C1008: x", "ERROR: 0:2: 'x' : undeclared"])
def test_every_drivers_way_to_name_a_line_is_understood(log):
    assert "b.glsl:7" in locate(f"failed\n{log}\n", ["a.glsl:1", "b.glsl:7"])


def test_720p_fits_with_half_logits(gl):
    # All 51 values a pixel that the full-size head predicts, in one buffer.
    assert math.prod((51, 720, 1280)) * 2 <= glsl.storage_limit(gl)
