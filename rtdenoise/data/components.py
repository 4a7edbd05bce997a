"""The components of a Metropolis render: parts of the beauty, split by the kind of mutation that found the light."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..frame import Frame

TOLERANCE = 0.02  # of the beauty in a pixel: half floats round each part by 2⁻¹¹, and the beauty
MAX_SHARE = 0.01  # of the pixels may differ by more, such as those beyond a half float's range
NOTHING_TO_SPLIT = {  # signal -> why it has no components
    "color": "there is nothing to split: only a Metropolis render (rtdenoise render --integrator pssmlt) has large.RGB "
    "and small.RGB; take --model default",
    "indirect": "the components make up the beauty; take --signal color",
}


def check_components(frame: Frame) -> None:
    """Raise InputError unless the components, where there are any, add up to the radiance. Layers are numpy arrays."""
    if frame.components is None:
        return
    with np.errstate(invalid="ignore", over="ignore"):
        total = frame.components.reshape(len(frame.radiance), -1, *frame.radiance.shape[1:]).sum(1)
        known = np.isfinite(total) & np.isfinite(frame.radiance)
        apart = known & (np.abs(total - frame.radiance) > TOLERANCE * np.abs(frame.radiance) + 1e-4)
    share = float(apart.any(1).mean())
    if share > MAX_SHARE:
        raise InputError(
            f"{frame.name}: large + small differ from the beauty in {share:.0%} of the pixels, by {TOLERANCE:.0%} or "
            "more; expected parts that add up to it: render the frame again, or take --model default"
        )
