"""Every likely way to read the two numbers of a stored motion vector: which field they are (`motion`, or `motion_next`
under the wrong name), which component is x, which sign each component has, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from ..data.layout import SCALES

SIZED = {"UV": SCALES["uv"], "NDC": SCALES["ndc"]}  # units that go by the size of the picture
UNITS = {"pixels": (1.0, "", ""), **SIZED, "double": (0.5, "½·", "½·"), "half": (2.0, "2·", "2·")}
REMEDIES = {
    "pixels": "", "UV": "UV units: multiply by (W, H)", "NDC": "NDC units: multiply by (W/2, H/2)",
    "double": "pixels of a picture twice as large: multiply by ½",
    "half": "pixels of a picture half as large: multiply by 2",
}  # fmt: skip


@dataclass(frozen=True)
class Reading:
    """One way to read the two numbers of a motion vector. The default is this project's convention."""

    source: str = "motion"  # or "motion_next": the two fields are swapped
    swapped: bool = False  # (y, x) instead of (x, y)
    signs: tuple[int, int] = (1, 1)  # of x and y
    unit: str = "pixels"  # "UV": fractions of the picture's size; "NDC": of half its size; or as in REMEDIES

    def apply(
        self,
        field: Tensor,  # [..., 2] of `source`, as stored
        size: tuple[int, int],  # (H, W) of the picture
    ) -> Tensor:  # [..., 2]
        """Motion in this project's convention."""
        H, W = size
        factor = UNITS[self.unit][0]
        scale = (W * factor, H * factor) if self.unit in SIZED else (factor, factor)
        return (field.flip(-1) if self.swapped else field) * torch.tensor(self.signs) * torch.tensor(scale)

    @property
    def changes(self) -> int:
        """Number of differences from this project's convention: among tied readings the one with fewest is named."""
        flips = 0 if self.signs == (1, 1) else 1 if self.signs in ((-1, -1), (1, -1)) else 2
        return flips + 2 * self.swapped + 2 * (self.unit != "pixels") + 3 * (self.source != "motion")

    @property
    def formula(self) -> str:
        """`motion = (W·X, -H·Y)`, in the components of the layer as it was read."""
        _, *scales = UNITS[self.unit]
        components = "YX" if self.swapped else "XY"
        x, y = (("-" if s < 0 else "") + k + c for s, k, c in zip(self.signs, scales, components, strict=True))
        return f"motion = {'' if self.source == 'motion' else 'motion_next '}({x}, {y})"

    def __str__(self) -> str:
        """The reading in words, and the remedy."""
        signs = {
            (-1, -1): "current - previous: negate it",
            (1, -1): "y up: flip y",
            (-1, 1): "current - previous with y up: flip x",
        }
        parts = [
            "the content of motion_next: read that layer" if self.source != "motion" else "",
            "(row, column): swap the components" if self.swapped else "",
            REMEDIES[self.unit],
            signs.get(self.signs, ""),
        ]
        return f"{'; '.join(p for p in parts if p) or 'previous - current, pixels, y down'} [{self.formula}]"


READINGS = tuple(
    Reading(source, swapped, signs, unit)
    for source, swapped, signs, unit in product(
        ("motion", "motion_next"), (False, True), ((1, 1), (-1, -1), (1, -1), (-1, 1)), UNITS
    )
    if unit in ("pixels", *SIZED) or (source, swapped) == ("motion", False)
)
DOUBLE, HALF = Reading(unit="double"), Reading(unit="half")
