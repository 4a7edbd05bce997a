"""The kernel-apply operations on the GPU. Each has the name, the meaning and the shapes of its twin in `rtdenoise.ops`.

Two forms, told apart by what is passed in:

- numpy arrays: computed in this thread's `default_context`, returned as a numpy array (float32; logits may be float16);
- `GpuArray`s of one context, the current one: nothing leaves the GPU. The result is a `GpuArray`: `out` where one is
  given, which must be none of the inputs.

Raises ValueError where shapes do not fit, InputError where there is no usable driver or an array is too large for it.
"""

from __future__ import annotations

import math

import numpy as np

from .context import GpuArray, default_context, storage_limit
from .dispatch import dispatch

Array = np.ndarray | GpuArray


def apply_kernel(
    image: Array,  # [B, C, H, W]
    logits: Array,  # [B, K², H, W], K odd; float32 or float16
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Filter every pixel with its own softmax-normalised K×K kernel.

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the image
        out[b,c,y,x] = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · image[b, c, y+dy-r, x+dx-r],    r = ⌊K/2⌋

    numpy logits that are larger than one buffer may be are worked off in bands of rows.
    """
    B, _, H, W = _shape("image", image)
    K = math.isqrt(_shape("logits", logits)[1])
    if K % 2 == 0:
        raise ValueError(f"expected logits [{B}, K², {H}, {W}] with K odd, got {tuple(logits.shape)}")
    _expect("logits", logits, (B, K * K, H, W))
    half = int(logits.dtype == np.float16)

    def run(image: Array, logits: Array) -> Array:
        B, C, H, W = image.shape
        return _run("apply_kernel", [image, logits], (B, C, H, W), (H, W), out, KERNEL=K, CHANNELS=C, LOGITS_HALF=half)

    if isinstance(image, GpuArray) or isinstance(logits, GpuArray):
        return run(image, logits)

    # A band takes the rows its kernels reach with it; what comes out for those is wrong at the cut and is dropped.
    reach = K // 2
    fitting = storage_limit(default_context()) // (B * K * K * W * (2 if half else 4))
    rows = H if fitting >= H else max(1, fitting - 2 * reach)
    bands = []
    for top in range(0, H, rows):
        first, last = max(0, top - reach), min(H, top + rows + reach)
        band = run(image[:, :, first:last], logits[:, :, first:last])
        bands.append(band[:, :, top - first : top - first + rows])
    return np.concatenate(bands, axis=2)


def warp(
    image: Array,  # [B, C, H, W]
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    out: GpuArray | None = None,  # [B, C, H, W]
    cubic: bool = False,
) -> Array:  # [B, C, H, W]
    """Reprojection, `out(p) = image(p + motion(p))`, bilinear or cubic (Catmull-Rom, which blurs less and overshoots
    nowhere); targets off the screen take the nearest border pixel."""
    B, C, H, W = _shape("image", image)
    _expect("motion", motion, (B, 2, H, W))
    return _run("warp", [image, motion], (B, C, H, W), (H, W), out, CHANNELS=C, CUBIC=int(cubic))


def fetch(
    image: Array,  # [B, C, H, W]
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Nearest reprojection, for motion, depth and normals: `out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]`."""
    B, C, H, W = _shape("image", image)
    _expect("motion", motion, (B, 2, H, W))
    return _run("fetch", [image, motion], (B, C, H, W), (H, W), out, CHANNELS=C)


def alike(
    surface: tuple[Array, Array],  # depth [B, 1, H, W] and normal [B, 3, H, W] at each pixel
    other: tuple[Array, Array],  # ... of what it is compared with
    depth_tolerance: float = 0.1,
    normal_tolerance: float = 0.5,
    out: GpuArray | None = None,  # [B, 1, H, W]
) -> Array:  # [B, 1, H, W] bool; as GpuArray float32, 1 or 0
    """Whether two pixels may show the same surface: depths that differ by at most `depth_tolerance` (relative) and
    normals whose cosine is `normal_tolerance` at least; two misses (depth 0) are alike, a hit and a miss are not."""
    B, _, H, W = _shape("depth", surface[0])
    _expect_surfaces(surface, other, (B, H, W))
    tolerance = {"tolerance": (depth_tolerance, normal_tolerance)}
    (result,) = _run_all("alike", [*surface, *other], [(B, 1, H, W)], (H, W), [out], tolerance)
    return result if isinstance(result, GpuArray) else result > 0


def reproject(
    stored: Array,  # [B, C, H, W] of the previous frame
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    surface: tuple[Array, Array],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    surface_previous: tuple[Array, Array],  # ... of the previous one, not reprojected
    depth_tolerance: float = 0.1,
    normal_tolerance: float = 0.5,
    out: tuple[GpuArray, GpuArray] | None = None,  # [B, C, H, W], [B, 1, H, W]
) -> tuple[Array, Array]:  # [B, C, H, W], [B, 1, H, W] bool; as GpuArray float32, 1 or 0
    """`warp` that takes no tap from another surface or from off the screen, and says where no tap was left."""
    B, C, H, W = _shape("stored", stored)
    _expect("motion", motion, (B, 2, H, W))
    _expect_surfaces(surface, surface_previous, (B, H, W))
    inputs, tolerance = [stored, motion, *surface, *surface_previous], (depth_tolerance, normal_tolerance)
    shapes = [(B, C, H, W), (B, 1, H, W)]
    found, valid = _run_all(
        "reproject", inputs, shapes, (H, W), list(out or (None, None)), {"tolerance": tolerance}, CHANNELS=C
    )
    return found, valid if isinstance(valid, GpuArray) else valid > 0


def downsample(
    image: Array,  # [B, C, H, W]
    pool: str = "mean",
    out: GpuArray | None = None,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
) -> Array:  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    """D of eq. 4: 2×2 pooling, 'mean' or 'max'."""
    B, C, H, W = _shape("image", image)
    return _run("downsample", [image], (B, C, *_halved(H, W)), (H, W), out, CHANNELS=C, POOL_MAX=_pool_max(pool))


def upsample(
    image: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    size: tuple[int, int],  # (H, W)
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """U of eq. 4: bilinear ×2 on the geometry of `downsample`."""
    B, C, _, _ = _shape("image", image)
    _expect("image", image, (B, C, *_halved(*size)))
    return _run("upsample", [image], (B, C, *size), size, out, CHANNELS=C)


def compose(
    fine: Array,  # [B, C, H, W]
    coarse: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    alpha: Array,  # [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1]
    pool: str = "mean",
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Replace the low frequencies of `fine` by those of `coarse`: `fine - U[α · D fine] + U[α · coarse]` (eq. 4)."""
    B, C, H, W = _shape("fine", fine)
    _expect("coarse", coarse, (B, C, *_halved(H, W)))
    _expect("alpha", alpha, (B, 1, *_halved(H, W)))
    return _run("compose", [fine, coarse, alpha], (B, C, H, W), (H, W), out, CHANNELS=C, POOL_MAX=_pool_max(pool))


def pick(
    fine: Array,  # [B, C, H, W]
    coarse: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    logits: Array,  # [B, K², H, W], K odd; float32 or float16
    share: Array,  # [B, 1, H, W] in [0, 1]
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Let every fine pixel pick from the K×K coarse ones around its own, as far as its share says:

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
        p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
        out[b,c,y,x] = (1 - share) · fine + share · p

    Logits must fit one buffer.
    """
    B, C, H, W = _shape("fine", fine)
    K = math.isqrt(_shape("logits", logits)[1])
    if K % 2 == 0:
        raise ValueError(f"expected logits [{B}, K², {H}, {W}] with K odd, got {tuple(logits.shape)}")
    _expect("logits", logits, (B, K * K, H, W))
    _expect("coarse", coarse, (B, C, *_halved(H, W)))
    _expect("share", share, (B, 1, H, W))
    inputs, half = [fine, logits, coarse, share], int(logits.dtype == np.float16)
    return _run("pick", inputs, (B, C, H, W), (H, W), out, KERNEL=K, CHANNELS=C, LOGITS_HALF=half)


def blend(
    spatial: Array,  # [B, C, H, W]
    temporal: Array,  # [B, C, H, W]
    alpha: Array,  # [B, 1, H, W] in [0, 1]
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """`out = α · spatial + (1 - α) · temporal`."""
    B, C, H, W = _shape("spatial", spatial)
    _expect("temporal", temporal, (B, C, H, W))
    _expect("alpha", alpha, (B, 1, H, W))
    return _run("blend", [spatial, temporal, alpha], (B, C, H, W), (H, W), out, CHANNELS=C)


def _run(
    name: str,
    inputs: list[Array],
    shape: tuple[int, ...],
    size: tuple[int, int],
    out: GpuArray | None,
    **constants: int,
) -> Array:
    """`_run_all` of a shader with one result."""
    return _run_all(name, inputs, [shape], size, [out], {}, **constants)[0]


def _run_all(
    name: str,  # of the shader
    inputs: list[Array],  # in the order of its bindings; the results come last
    shapes: list[tuple[int, ...]],  # [B, C, H, W] of the results
    size: tuple[int, int],  # (H, W) of the finer grid
    outs: list[GpuArray | None],
    uniforms: dict,
    **constants: int,
) -> list[Array]:
    """One dispatch, an invocation for every pixel of the results."""
    dtypes = [np.float16 if constants.get("LOGITS_HALF") and i == 1 else np.float32 for i in range(len(inputs))]
    resident = {isinstance(array, GpuArray) for array in inputs}
    if len(resident) > 1:
        raise ValueError(f"{name}: expected either numpy arrays or GpuArrays, got both")
    if any(out is not None for out in outs) and resident == {False}:
        raise ValueError(f"{name}: `out` goes with GpuArrays only")
    if resident == {True}:
        ctx, arrays = inputs[0].buffer.ctx, inputs
    else:
        ctx = default_context()
        arrays = [GpuArray.upload(ctx, array, dtype) for array, dtype in zip(inputs, dtypes, strict=True)]
    results = [out or GpuArray.empty(ctx, shape) for out, shape in zip(outs, shapes, strict=True)]
    for result, shape in zip(results, shapes, strict=True):
        _expect("out", result, shape)
        if any(array.buffer is result.buffer for array in arrays):
            raise ValueError(f"{name}: `out` must be none of the inputs")
    for array, dtype in zip([*arrays, *results], [*dtypes, *(np.float32 for _ in results)], strict=True):
        if array.dtype != dtype:
            raise ValueError(f"{name}: expected {np.dtype(dtype)}, got {array.dtype}")

    B, _, H, W = shapes[0]
    dispatch(f"ops/{name}", [*arrays, *results], (W, H, B), {"size": size[::-1], **uniforms}, **constants)
    return results if resident == {True} else [result.read() for result in results]


def _shape(name: str, array: Array) -> tuple[int, int, int, int]:
    if len(array.shape) != 4:
        raise ValueError(f"expected {name} [B, C, H, W], got {tuple(array.shape)}")
    return tuple(array.shape)


def _expect(name: str, array: Array, shape: tuple[int, ...]) -> None:
    if tuple(array.shape) != tuple(shape):
        raise ValueError(f"expected {name} {tuple(shape)}, got {tuple(array.shape)}")


def _expect_surfaces(surface: tuple[Array, Array], other: tuple[Array, Array], size: tuple[int, int, int]) -> None:
    B, H, W = size
    for depth, normal in (surface, other):
        _expect("depth", depth, (B, 1, H, W))
        _expect("normal", normal, (B, 3, H, W))


def _halved(H: int, W: int) -> tuple[int, int]:
    return (H + 1) // 2, (W + 1) // 2


def _pool_max(pool: str) -> int:
    if pool not in ("mean", "max"):
        raise ValueError(f"expected pool 'mean' or 'max', got {pool!r}")
    return int(pool == "max")
