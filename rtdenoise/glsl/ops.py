"""The kernel-apply operations on the GPU. Each has the name, the meaning and the shapes of its twin in `rtdenoise.ops`.

The type of the inputs chooses one of two forms:

- numpy arrays: computed in this thread's `default_context`, returned as a numpy array (float32; logits may be float16);
- `GpuArray`s of one context: nothing leaves the GPU. The result is a `GpuArray`: `out` where one is given,
  which must be none of the inputs.

Raises ValueError where shapes do not fit, InputError where there is no usable driver or an array is too large for it.
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import DEPTH_TOLERANCE, MIN_NORMAL_COSINE
from .context import GpuArray, default_context, storage_limit
from .operation import Array, expect, run, run_all, shape_of


def apply_kernel(
    image: Array,  # [B, C, H, W]
    logits: Array,  # [B, K², H, W], K odd; float32 or float16
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Filter every pixel with its own softmax-normalised K×K kernel.

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the image
        out[b,c,y,x] = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · image[b, c, y+dy-r, x+dx-r],    r = ⌊K/2⌋

    numpy logits too large for one buffer are processed in bands of rows. Images beyond 3.4e38 / K² may overflow.
    """
    B, _, H, W = shape_of("image", image)
    K = math.isqrt(shape_of("logits", logits)[1])
    if K % 2 == 0:
        raise ValueError(f"expected logits [{B}, K², {H}, {W}] with K odd, got {tuple(logits.shape)}")
    expect("logits", logits, (B, K * K, H, W))
    half = int(logits.dtype == np.float16)

    def filter_band(image: Array, logits: Array) -> Array:
        B, C, H, W = image.shape
        inputs = {"image": image, "logits": logits}
        return run("apply_kernel", inputs, (B, C, H, W), (H, W), out, KERNEL=K, CHANNELS=C, LOGITS_HALF=half)

    if isinstance(image, GpuArray) or isinstance(logits, GpuArray) or not image.size:
        return filter_band(image, logits)

    # A band includes the rows that its kernels reach; their own results are wrong at the cut and are dropped.
    reach = K // 2
    fitting = storage_limit(default_context()) // (B * K * K * W * (2 if half else 4))
    rows = H if fitting >= H else max(1, fitting - 2 * reach)
    bands = []
    for top in range(0, H, rows):
        first, last = max(0, top - reach), min(H, top + rows + reach)
        band = filter_band(image[:, :, first:last], logits[:, :, first:last])
        bands.append(band[:, :, top - first : top - first + rows])
    return np.concatenate(bands, axis=2)


def attend_blocks(
    q: Array,  # [B, C, H, W] queries
    k: Array,  # [B, C, H, W] keys
    v: Array,  # [B, C, H, W] values
    rows: Array,  # [C / heads / 2, block + 2·halo]
    columns: Array,  # [C / heads / 2, block + 2·halo]
    out: GpuArray | None = None,  # [B, C, H, W]
    *,
    block: int = 8,
    halo: int = 3,
    heads: int = 4,
) -> Array:  # [B, C, H, W]
    """Every pixel takes a weighted mean of the values in the window of its block, as `ops.attend_blocks`:

        e[n]     = (rows[:, n_y], columns[:, n_x])
        out[h,p] = Σ_n softmax_n(q[h,p] · (k[h,n] + e[n]) / √d) · v[h,n]

    Fastest for blocks of 8×8: a block is then a work group.
    """
    B, C, H, W = shape_of("q", q)
    expect("k", k, (B, C, H, W))
    expect("v", v, (B, C, H, W))
    if block < 1 or halo < 0 or heads < 1 or C % (2 * heads):
        raise ValueError(f"expected a block of 1 or more, a halo of 0 or more and channels in {heads} heads of an even "
                         f"number each, got block {block}, halo {halo} and {C} channels")  # fmt: skip
    for name, offsets in (("rows", rows), ("columns", columns)):
        expect(name, offsets, (C // heads // 2, block + 2 * halo))
    inputs = {"q": q, "k": k, "v": v, "rows": rows, "columns": columns}
    constants = {"CHANNELS": C, "HEADS": heads, "BLOCK": block, "HALO": halo}
    return run("attend_blocks", inputs, (B, C, H, W), (H, W), out, (8, 8), **constants)


def warp(
    image: Array,  # [B, C, H, W]
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    out: GpuArray | None = None,  # [B, C, H, W]
    cubic: bool = False,
) -> Array:  # [B, C, H, W]
    """Reprojection, `out(p) = image(p + motion(p))`, bilinear or cubic (Catmull-Rom, which blurs less and overshoots
    nowhere); targets off the screen take the nearest border pixel."""
    B, C, H, W = shape_of("image", image)
    expect("motion", motion, (B, 2, H, W))
    return run("warp", {"image": image, "motion": motion}, (B, C, H, W), (H, W), out, CHANNELS=C, CUBIC=int(cubic))


def fetch(
    image: Array,  # [B, C, H, W]
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Nearest reprojection, for motion, depth and normals: `out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]`."""
    B, C, H, W = shape_of("image", image)
    expect("motion", motion, (B, 2, H, W))
    return run("fetch", {"image": image, "motion": motion}, (B, C, H, W), (H, W), out, CHANNELS=C)


def alike(
    surface: tuple[Array, Array],  # depth [B, 1, H, W] and normal [B, 3, H, W] at each pixel
    other: tuple[Array, Array],  # the same, of the surface to compare with
    depth_tolerance: float = DEPTH_TOLERANCE,
    normal_tolerance: float = MIN_NORMAL_COSINE,
    out: GpuArray | None = None,  # [B, 1, H, W]
) -> Array:  # [B, 1, H, W] bool; as GpuArray float32, 1 or 0
    """Whether two pixels may show the same surface: depths that differ by at most `depth_tolerance` (relative) and
    normals whose cosine is `normal_tolerance` at least; two misses (depth 0) are alike, a hit and a miss are not."""
    B, _, H, W = shape_of("depth", surface[0])
    _expect_surfaces(surface, other, (B, H, W))
    inputs = dict(zip(("depth", "normal", "other_depth", "other_normal"), (*surface, *other), strict=True))
    tolerance = {"tolerance": (depth_tolerance, normal_tolerance)}
    (result,) = run_all("alike", inputs, {"result": (B, 1, H, W)}, (H, W), [out], tolerance)
    return result if isinstance(result, GpuArray) else result > 0


def reproject(
    stored: Array,  # [B, C, H, W] of the previous frame
    motion: Array,  # [B, 2, H, W] (x, y) in pixels
    surface: tuple[Array, Array],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    surface_previous: tuple[Array, Array],  # the same of the previous frame, not reprojected
    depth_tolerance: float = DEPTH_TOLERANCE,
    normal_tolerance: float = MIN_NORMAL_COSINE,
    out: tuple[GpuArray, GpuArray] | None = None,  # [B, C, H, W], [B, 1, H, W]
) -> tuple[Array, Array]:  # [B, C, H, W], [B, 1, H, W] bool; as GpuArray float32, 1 or 0
    """`warp` that takes no tap from another surface or from off the screen, and says where no tap was left."""
    B, C, H, W = shape_of("stored", stored)
    expect("motion", motion, (B, 2, H, W))
    _expect_surfaces(surface, surface_previous, (B, H, W))
    inputs = {"stored": stored, "motion": motion, "depth": surface[0], "normal": surface[1],
              "depth_before": surface_previous[0], "normal_before": surface_previous[1]}  # fmt: skip
    shapes = {"result": (B, C, H, W), "valid": (B, 1, H, W)}
    tolerance = {"tolerance": (depth_tolerance, normal_tolerance)}
    found, valid = run_all("reproject", inputs, shapes, (H, W), out or (None, None), tolerance, CHANNELS=C)
    return found, valid if isinstance(valid, GpuArray) else valid > 0


def downsample(
    image: Array,  # [B, C, H, W]
    pool: str = "mean",
    out: GpuArray | None = None,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
) -> Array:  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    """D of eq. 4: 2×2 pooling, 'mean' or 'max'."""
    B, C, H, W = shape_of("image", image)
    shape = (B, C, *_halved(H, W))
    return run("downsample", {"fine": image}, shape, (H, W), out, CHANNELS=C, POOL_MAX=_pool_max(pool))


def upsample(
    image: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    size: tuple[int, int],  # (H, W)
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """U of eq. 4: bilinear ×2 on the geometry of `downsample`."""
    B, C, _, _ = shape_of("image", image)
    expect("image", image, (B, C, *_halved(*size)))
    return run("upsample", {"coarse": image}, (B, C, *size), size, out, CHANNELS=C)


def compose(
    fine: Array,  # [B, C, H, W]
    coarse: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    alpha: Array,  # [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1]
    pool: str = "mean",
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Replace the low frequencies of `fine` by those of `coarse`: `fine - U[α · D fine] + U[α · coarse]` (eq. 4)."""
    B, C, H, W = shape_of("fine", fine)
    expect("coarse", coarse, (B, C, *_halved(H, W)))
    expect("alpha", alpha, (B, 1, *_halved(H, W)))
    inputs = {"fine": fine, "coarse": coarse, "alpha": alpha}
    return run("compose", inputs, (B, C, H, W), (H, W), out, CHANNELS=C, POOL_MAX=_pool_max(pool))


def soften(
    composed: Array,  # [B, C, H, W]
    fine: Array,  # [B, C, H, W]
    share: Array,  # [B, 1, H, W] in [0, 1]
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Keep a share of the detail that only the finer image has: `composed - (1 - share) · (fine - U[D fine])`."""
    B, C, H, W = shape_of("fine", fine)
    expect("composed", composed, (B, C, H, W))
    expect("share", share, (B, 1, H, W))
    inputs = {"composed": composed, "fine": fine, "share": share}
    return run("soften", inputs, (B, C, H, W), (H, W), out, CHANNELS=C, POOL_MAX=0)


def pick(
    fine: Array,  # [B, C, H, W]
    coarse: Array,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    logits: Array,  # [B, K², H, W], K odd; float32 or float16
    share: Array,  # [B, 1, H, W] in [0, 1]
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """Blend every fine pixel with a weighted mean of the K×K coarse pixels around its own:

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
        p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
        out[b,c,y,x] = (1 - share) · fine + share · p

    Logits must fit one buffer.
    """
    B, C, H, W = shape_of("fine", fine)
    K = math.isqrt(shape_of("logits", logits)[1])
    if K % 2 == 0:
        raise ValueError(f"expected logits [{B}, K², {H}, {W}] with K odd, got {tuple(logits.shape)}")
    expect("logits", logits, (B, K * K, H, W))
    expect("coarse", coarse, (B, C, *_halved(H, W)))
    expect("share", share, (B, 1, H, W))
    inputs, half = {"fine": fine, "coarse": coarse, "logits": logits, "share": share}, int(logits.dtype == np.float16)
    return run("pick", inputs, (B, C, H, W), (H, W), out, KERNEL=K, CHANNELS=C, LOGITS_HALF=half)


def blend(
    spatial: Array,  # [B, C, H, W]
    temporal: Array,  # [B, C, H, W]
    alpha: Array,  # [B, 1, H, W] in [0, 1]
    out: GpuArray | None = None,  # [B, C, H, W]
) -> Array:  # [B, C, H, W]
    """`out = α · spatial + (1 - α) · temporal`."""
    B, C, H, W = shape_of("spatial", spatial)
    expect("temporal", temporal, (B, C, H, W))
    expect("alpha", alpha, (B, 1, H, W))
    inputs = {"spatial": spatial, "temporal": temporal, "alpha": alpha}
    return run("blend", inputs, (B, C, H, W), (H, W), out, CHANNELS=C)


def _expect_surfaces(surface: tuple[Array, Array], other: tuple[Array, Array], size: tuple[int, int, int]) -> None:
    B, H, W = size
    for depth, normal in (surface, other):
        expect("depth", depth, (B, 1, H, W))
        expect("normal", normal, (B, 3, H, W))


def _halved(H: int, W: int) -> tuple[int, int]:
    return (H + 1) // 2, (W + 1) // 2


def _pool_max(pool: str) -> int:
    if pool not in ("mean", "max"):
        raise ValueError(f"expected pool 'mean' or 'max', got {pool!r}")
    return int(pool == "max")
