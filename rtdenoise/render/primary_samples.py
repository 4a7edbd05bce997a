"""Paths as points of the unit cube: the random numbers that make a path, and their mutations.

Import it only after a Mitsuba variant has been set. The source is "A Simple and Robust Mutation Strategy for the
Metropolis Light Transport Algorithm" (Kelemen et al. 2002).

A path is made of D numbers: two for its place in the picture, two for the lens where the camera has one, five a bounce.
Those of N chains are one array u of D·N floats; number d of chain i is u[d·N + i]. Mutations have no state: their
random numbers are a hash of (chain, number, step), so two kernels can compute the same proposal and none stores it.
"""

from __future__ import annotations

from math import log
from typing import ClassVar

import drjit as dr
import mitsuba as mi

PER_BOUNCE = 5  # random numbers that `tracing.trace` takes: emitter 2, BSDF 1 + 2
SMALLEST, LARGEST = 1 / 1024, 1 / 64  # lengths of small steps, as in Mitsuba 0.6
ROUNDS = 8  # of the hash; with Mitsuba's default of 4 neighbouring inputs give dependent numbers, and a wrong picture
CHOICE = 1 << 31  # added to the chain: numbers that belong to the whole mutation


def dimensions(max_depth: int, lens: bool) -> int:
    """Numbers that a path of at most `max_depth` edges needs; holes that it passes take more (`replay`)."""
    return 2 + 2 * lens + PER_BOUNCE * max(max_depth - 1, 1)


def hashed(index, key):
    """Two independent `Float` in [0, 1), and the bits of the first that it does not use, for every (index, key)."""
    a, b = mi.sample_tea_32(index, key, ROUNDS)
    return _unit(a), _unit(b), a & 0xFF


def _unit(bits):
    return mi.Float(bits >> 8) * 2**-24


def fresh(path, count: int, key: int):
    """The numbers of independent paths, `count` of them, as a function of the dimension."""
    count, key = (dr.opaque(mi.UInt32, number) for number in (count, key))
    return lambda dimension: hashed(dimension * count + path, key)[0]


def wrapped(u):
    """u on the circle: [0, 1). A tiny negative number plus 1 rounds to 1, which is 0 here."""
    u = u - dr.floor(u)
    return dr.select(u >= 1, 0, u)


def mutated(u, index, key, large, smallest=SMALLEST, largest=LARGEST):
    """The proposal for the numbers u: fresh ones where `large`, else moved either way by `smallest` to `largest`, with
    a density that falls as one over the distance."""
    fresh, distance, bits = hashed(index, key)
    move = largest * dr.exp(-log(largest / smallest) * distance)
    return dr.select(large, fresh, wrapped(u + dr.select(bits < 128, move, -move)))


class Replay:
    """A sampler for `tracing`: returns number(0), number(1), ... in every lane. Made by `replay`.

    Dr.Jit copies loop variables field by field, so only `DRJIT_STRUCT` belongs to the instance, the rest to its class.
    """

    DRJIT_STRUCT: ClassVar = {"dimension": mi.UInt32, "place": mi.UInt32}
    number, count, endless = None, 0, False

    def __init__(self):
        self.dimension, self.place = mi.UInt32(0), mi.UInt32(0)

    def start(self):
        """The point of the film, in [0, 1)²."""
        point = self.next_2d()
        self.place = dr.reinterpret_array(mi.UInt32, point.x) ^ (dr.reinterpret_array(mi.UInt32, point.y) << 7)
        return point

    def next_1d(self, active=True):
        value = self.number(dr.minimum(self.dimension, self.count - 1))  # the last edge of a path asks for more
        if self.endless:
            beyond = hashed(self.place, self.dimension)[0]
            value = dr.select(self.dimension < self.count, value, beyond)
        self.dimension = self.dimension + 1
        return value

    def next_2d(self, active=True):
        first = self.next_1d(active)
        return mi.Point2f(first, self.next_1d(active))


def replay(number, count: int, endless: bool = False) -> Replay:
    """The sampler that returns number(d), number: `UInt32` to `Float`, for the dimensions d = 0, 1, ... count − 1.

    With `endless`, for paths through any number of holes, a hash of the path's place in the picture follows.
    """
    return type("Replay", (Replay,), {"number": staticmethod(number), "count": count, "endless": endless})()
