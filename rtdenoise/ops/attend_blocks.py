"""Attention of every pixel to a window around its block."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn import functional as F

from .dispatch import plain, transformed

MAX_UNFOLDED = 1 << 24  # numbers in the unfolded keys of a strip, and as many in its values: 64 MB each


def attend_blocks(
    q: Tensor,  # [B, C, H, W] queries
    k: Tensor,  # [B, C, H, W] keys
    v: Tensor,  # [B, C, H, W] values
    rows: Tensor,  # [C / heads / 2, block + 2·halo] offsets of the first half of a head's keys, by row of the window
    columns: Tensor,  # [C / heads / 2, block + 2·halo] of the other half, by column
    *,
    block: int = 8,
    halo: int = 3,
    heads: int = 4,
) -> Tensor:  # [B, C, H, W]
    """Every pixel takes a weighted mean of the values in the window of its block: the block×block pixels of a grid that
    starts at the upper left corner, and `halo` pixels on every side. With d = C / heads, for a pixel p, a head h and
    the positions n of p's window that lie inside the picture:

        e[n]     = (rows[:, n_y], columns[:, n_x])
        s[h,p,n] = q[h,p] · (k[h,n] + e[n]) / √d
        out[h,p] = Σ_n softmax_n(s[h,p,n]) · v[h,n]

    Positions outside the picture get no weight, so a constant stays constant at borders. Any size will do: the border
    cuts the last blocks off. Yu et al. 2021, §3.2; heads and offsets are those of its authors' code, where positions
    outside the picture do take weight.

    The plain version holds all windows and scores at once. The other one goes through strips of blocks with
    `F.scaled_dot_product_attention`, which stores no scores, and masks blocks at borders alone.

    Raises ValueError where the shapes do not fit.
    """
    _check(q, k, v, rows, columns, block, halo, heads)
    if q.numel() == 0:
        return torch.zeros_like(v)
    offsets = _offsets(rows, columns)
    if plain() or transformed(q, k, v, offsets):
        return _specification(q, k, v, offsets, block, halo, heads)
    B, C, H, W = q.shape
    most = max(1, MAX_UNFOLDED // (B * C * (block + 2 * halo) ** 2))  # blocks at once
    across = -(-W // block)
    picture = []
    for top, bottom, inside in _spans(H, block, halo, max(1, most // across)):
        strip = [
            _attend(q, k, v, offsets, (top, left, bottom, right), inside_x, block, halo, heads)
            for left, right, inside_x in _spans(W, block, halo if inside else W, most)  # by W: no window is inside
        ]
        picture.append(torch.cat(strip, dim=3))
    return torch.cat(picture, dim=2)


def _specification(q: Tensor, k: Tensor, v: Tensor, offsets: Tensor, block: int, halo: int, heads: int) -> Tensor:
    """The equation for all blocks l at once: scores are [B, heads, l, p, n]."""
    H, W = q.shape[2:]
    below, right, window = -H % block, -W % block, block + 2 * halo

    def windows(x: Tensor, heads: int = heads) -> Tensor:  # [B, C, H, W] -> [B, heads, d, n, l]
        around = F.pad(x, (halo, halo + right, halo, halo + below))
        return F.unfold(around, window, stride=block).unflatten(1, (heads, x.shape[1] // heads, window**2))

    keys, values = windows(k) + offsets.to(k.dtype).T[:, :, None], windows(v)
    inside = windows(torch.ones_like(q[:, :1]), heads=1).transpose(2, 4) > 0  # [B, 1, l, n, 1]
    queries = F.unfold(F.pad(q, (0, right, 0, below)), block, stride=block)
    queries = queries.unflatten(1, (heads, q.shape[1] // heads, block**2))  # [B, heads, d, p, l]
    scores = torch.einsum("bhdpl,bhdnl->bhlpn", queries, keys) * queries.shape[2] ** -0.5
    scores = scores.masked_fill(~inside.transpose(3, 4), -torch.inf)
    out = torch.einsum("bhlpn,bhdnl->bhdpl", scores.softmax(-1), values)
    return F.fold(out.flatten(1, 3), (H + below, W + right), block, stride=block)[:, :, :H, :W]


def _attend(
    q: Tensor,
    k: Tensor,
    v: Tensor,
    offsets: Tensor,  # [n, d]
    blocks: tuple[int, int, int, int],  # top, left, bottom, right: which ones
    inside: bool,  # all their windows lie inside the picture
    block: int,
    halo: int,
    heads: int,
) -> Tensor:
    """The result for a rectangle of blocks, as far as it lies inside the picture."""
    (B, C, H, W), window = q.shape, block + 2 * halo
    top, left, bottom, right = (block * place for place in blocks)
    height, width = (bottom - top) // block, (right - left) // block
    corner = top - halo, left - halo
    queries, keys, values = (  # [blocks, heads, positions, d]
        x.reshape(B * height * width, -1, heads, C // heads).transpose(1, 2)
        for x in (
            _windows(q, (top, left), (height, width), block, block),
            _windows(k, corner, (height, width), block, window),
            _windows(v, corner, (height, width), block, window),
        )
    )
    mask = None
    if not inside:
        y, x = (
            (torch.arange(count, device=q.device)[:, None] * block + torch.arange(window, device=q.device)) + start
            for count, start in zip((height, width), corner, strict=True)
        )
        mask = ((y >= 0) & (y < H))[:, None, :, None] & ((x >= 0) & (x < W))[None, :, None, :]
        mask = mask.reshape(1, height * width, 1, 1, window**2).expand(B, -1, -1, -1, -1).flatten(0, 1)
    out = F.scaled_dot_product_attention(queries, keys + offsets.to(keys.dtype), values, attn_mask=mask)
    out = out.transpose(1, 2).reshape(B, height, width, block, block, C).permute(0, 5, 1, 3, 2, 4)
    return out.reshape(B, C, bottom - top, right - left)[:, :, : H - top, : W - left]


def _windows(
    x: Tensor,  # [B, C, H, W], taken as 0 outside
    corner: tuple[int, int],  # row and column of the first window's first pixel
    count: tuple[int, int],  # windows in a column and in a row
    block: int,  # pixels from window to window
    window: int,  # their side
) -> Tensor:  # [B, rows, columns, window, window, C]
    """Windows as pieces of neighbouring cells of block×block pixels: `Tensor.unfold` has a slow backward."""
    (H, W), (top, left) = x.shape[2:], corner
    pieces = [min(block, window - i) for i in range(0, window, block)]
    bottom, right = (start + (n + len(pieces) - 1) * block for start, n in zip(corner, count, strict=True))
    beyond = max(0, -left), max(0, right - W), max(0, -top), max(0, bottom - H)
    x = x[:, :, max(0, top) : min(H, bottom), max(0, left) : min(W, right)]
    x = (F.pad(x, beyond) if any(beyond) else x).permute(0, 2, 3, 1)
    x = x.unflatten(2, (-1, block)).unflatten(1, (-1, block))  # [B, rows, y, columns, x, C] of cells
    x = torch.cat([x[:, i : i + count[0], :side] for i, side in enumerate(pieces)], dim=2).transpose(2, 3)
    return torch.cat([x[:, :, i : i + count[1], :, :side] for i, side in enumerate(pieces)], dim=4)


def _spans(length: int, block: int, halo: int, most: int) -> Iterator[tuple[int, int, bool]]:
    """The blocks along an axis in spans of at most `most`: first and last (excluded), and whether their windows lie
    inside the picture."""
    count, first = -(-length // block), -(-halo // block)
    last = max(first, (length - halo) // block)
    for start, stop, inside in ((0, first, False), (first, last, True), (last, count, False)):
        for i in range(start, min(stop, count), most):
            yield i, min(i + most, stop, count), inside


def _offsets(rows: Tensor, columns: Tensor) -> Tensor:
    """e[n], `[positions, d]`."""
    window = rows.shape[1]
    return torch.cat([rows.T.repeat_interleave(window, 0), columns.T.repeat(window, 1)], dim=1)


def _check(q: Tensor, k: Tensor, v: Tensor, rows: Tensor, columns: Tensor, block: int, halo: int, heads: int) -> None:
    if q.ndim != 4 or k.shape != q.shape or v.shape != q.shape:
        raise ValueError(f"expected q, k and v [B, C, H, W] of one shape, got {tuple(q.shape)}, {tuple(k.shape)} and "
                         f"{tuple(v.shape)}")  # fmt: skip
    if block < 1 or halo < 0 or heads < 1 or q.shape[1] % (2 * heads):
        raise ValueError(f"expected a block of 1 or more, a halo of 0 or more and channels in {heads} heads of an even "
                         f"number each, got block {block}, halo {halo} and {q.shape[1]} channels")  # fmt: skip
    if rows.shape != (expected := (q.shape[1] // heads // 2, block + 2 * halo)) or columns.shape != expected:
        raise ValueError(f"expected rows and columns {expected}, got {tuple(rows.shape)} and {tuple(columns.shape)}")
