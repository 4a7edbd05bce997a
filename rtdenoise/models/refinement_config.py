"""The description of a block of guided self-attention at a quarter of the image size (`refinement`). Needs no torch."""

REFINED_BLOCK, REFINED_HALO, REFINED_HEADS = (
    8,
    3,
    4,
)  # block and halo in cells of 4×4 pixels
REFINED_REACH = 4 * (REFINED_BLOCK + REFINED_HALO)  # pixels
SURFACE = 7  # channels that guide it: albedo 3, normal 3, nearness 1


def refined_shapes(prefix: str, width: int) -> dict[str, tuple[int, ...]]:
    """The shapes of its tensors for a level of `width` channels."""
    shapes = {"join.weight": (width, width + SURFACE, 1, 1), "join.bias": (width,)}
    shapes |= {f"{name}.weight": (width, width, 1, 1) for name in ("query", "key", "value", "out")}
    offsets = width // REFINED_HEADS // 2, REFINED_BLOCK + 2 * REFINED_HALO
    shapes |= {"out.bias": (width,), "rows": offsets, "columns": offsets}
    return {prefix + name: shape for name, shape in shapes.items()}
