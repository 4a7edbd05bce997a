"""TRMV for occlusions: SVGF on dual motion vectors (Zeng et al., *Temporally Reliable Motion Vectors for Real-time Ray
Tracing*, Computer Graphics Forum 2021)."""

from __future__ import annotations

from dataclasses import dataclass

from .svgf import Svgf


@dataclass(frozen=True)
class Trmv(Svgf):
    """Uncovered pixels take the history of background beside the occluder, where `Svgf` finds none and starts anew.

    What is reused is demodulated irradiance, so that the background's texture does not come along with it: for diffuse
    surfaces that is what the publication's reuse of incident radiance amounts to; its lobes for glossy ones, and its
    motion vectors for shadows and reflections, are not here.
    """

    motion: str = "dual"
