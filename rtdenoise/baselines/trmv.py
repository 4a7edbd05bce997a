"""TRMV for occlusions: SVGF on dual motion vectors (Zeng et al., *Temporally Reliable Motion Vectors for Real-time Ray
Tracing*, Computer Graphics Forum 2021)."""

from __future__ import annotations

from dataclasses import dataclass

from .svgf import Svgf


@dataclass(frozen=True)
class Trmv(Svgf):
    """Uncovered pixels take the history of the background beside the occluder; there `Svgf` starts anew.

    The reused signal is demodulated irradiance, without the texture of the background. On diffuse surfaces this equals
    the publication's reuse of incident radiance; its lobes for glossy surfaces and its motion vectors for shadows and
    reflections are not implemented.
    """

    motion: str = "dual"
