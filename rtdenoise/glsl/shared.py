"""Constants that shaders share with the rest of the package. A shader asks for one by its name: `#pragma constants
GLOSS`."""

from __future__ import annotations

from .. import constants, frame, sanitise

SHARED: dict[str, int | float | tuple[float, ...]] = {
    **{name: value for name, value in vars(constants).items() if name.isupper()},
    "OFF_SCREEN": frame.OFF_SCREEN,
    "OCCLUSION_THRESHOLD": frame.OCCLUSION_THRESHOLD,
    "BRIGHTEST": sanitise.BRIGHTEST,
    "FAR": sanitise.FAR,
    "GREATEST_ALBEDO": sanitise.GREATEST_ALBEDO,
    "LONGEST_NORMAL": sanitise.LONGEST_NORMAL,
}
