"""Metropolis sampling in primary sample space, many chains at once.

Import it only after a Mitsuba variant has been set.

A chain walks through the numbers that make paths (`primary_samples`) and stays where light is: in the long run it is at
u with a density of f(u)/b, where f is the luminance that the path of u brings and b the mean of f. A *large* step draws
all numbers anew, with probability p; these proposals are ordinary path tracing, and are combined with the chains'
samples by the balance heuristic, as Kelemen et al. (2002) do:

    picture = mean over mutations of (b/b₀) · (weight of the state) · c/(f/b₀ + p)  +  [large] · c'/(f'/b₀ + p)

with c the light of the current path and c' that of the proposed one. Both add the share that they are expected to get:
1 − a and a, for a proposal that is accepted with probability a. b₀ is the first estimate of b, from the bootstrap; any
b₀ gives the right picture where b is right, so the final b is that of bootstrap and large steps together.
"""

from __future__ import annotations

import gc
from contextlib import contextmanager
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .primary_samples import CHOICE, LARGEST, SMALLEST, dimensions, fresh, hashed, mutated, replay
from .streams import stream_seed
from .tracing import View, rays_through, trace

MAX_PATHS = 1 << 20  # of the bootstrap at once; bounds memory
PATHS_PER_CHAIN, MIN_PATHS = 16, 1 << 15  # of the bootstrap


@dataclass
class Picture:
    """What is traced. Numbers that differ from picture to picture are data, so that kernels are reused."""

    scene: mi.Scene
    kinds: list  # BSDFs that may be called besides the scene's
    view: View
    height: mi.UInt32
    width: mi.UInt32
    pixels: int
    max_depth: int
    holes: bool

    @property
    def dimensions(self) -> int:
        return dimensions(self.max_depth, self.view.lens)


@dataclass
class Law:
    """How chains move."""

    smallest: float = SMALLEST
    largest: float = LARGEST
    large: float = 0.3  # probability of large steps
    replaced: bool = False  # attribute a state's light to the step that replaces it, not to the step that made it


@dataclass
class Chains:
    """The states of N chains, and what they have seen."""

    u: mi.Float  # [D·N]
    color: mi.Color3f
    indirect: mi.Color3f
    value: mi.Float  # luminance
    pixel: mi.UInt32
    large: mi.Bool  # made by a large step
    weight: mi.Float  # of the state's light, that is not on the film yet
    total: mi.Float  # of the luminances of large proposals,
    squares: mi.Float  # of their squares,
    proposed: mi.UInt32  # and their number
    taken_large: mi.UInt32
    taken_small: mi.UInt32
    count: mi.UInt32  # N, one number


@dataclass
class Films:
    """Sums of light, [pixels · 3] and `chains` [pixels · 2 · 3]: by large steps, by small ones."""

    chains: mi.Float
    chains_indirect: mi.Float
    large: mi.Float  # large proposals, weighted against the chains
    large_indirect: mi.Float
    proposals: mi.Float  # large proposals as they are


def light_of(picture: Picture, number):
    """(beauty, indirect, luminance, pixel) of the paths that `number` makes; the luminance is never negative or NaN."""
    sampler = replay(number, picture.dimensions, picture.holes)
    point = sampler.start()
    x, y = point.x * mi.Float(picture.width), point.y * mi.Float(picture.height)
    column, row = dr.minimum(mi.UInt32(x), picture.width - 1), dr.minimum(mi.UInt32(y), picture.height - 1)
    ray = rays_through(x, y, sampler, picture.view)
    direct, indirect = trace(picture.scene, sampler, ray, picture.max_depth, picture.holes)
    color = direct + indirect
    value = mi.luminance(color)
    value = dr.select(dr.isfinite(value) & (value > 0), value, 0)
    return color, indirect, value, row * picture.width + column


def bootstrap(picture: Picture, count: int, key: int) -> np.ndarray:
    """Luminances of `count` independent paths, [count] float64; path i is made of `fresh(i, count, key)`."""
    found = []
    for start in range(0, count, MAX_PATHS):
        path = dr.arange(mi.UInt32, min(MAX_PATHS, count - start)) + dr.opaque(mi.UInt32, start)
        found.append(np.array(light_of(picture, fresh(path, count, key))[2], np.float64))
    return np.concatenate(found)


def seeds(values: np.ndarray, count: int, offset: float) -> np.ndarray:
    """`count` indices, drawn in proportion to the values by systematic resampling; offset in [0, 1)."""
    sums = np.cumsum(values)
    points = (np.arange(count) + offset) / count * sums[-1]
    return np.minimum(np.searchsorted(sums, points, side="right"), len(values) - 1).astype(np.uint32)


def begin(picture: Picture, chosen: np.ndarray, paths: int, key: int) -> tuple[Chains, Films]:
    """Chains at the chosen paths of the bootstrap, and empty films."""
    N, pixels = len(chosen), picture.pixels
    path, count = mi.UInt32(chosen), dr.opaque(mi.UInt32, N)
    lane, dimension = _lanes(picture.dimensions * N, count)
    u = fresh(dr.gather(mi.UInt32, path, lane), paths, key)(dimension)
    color, indirect, value, pixel = light_of(picture, fresh(path, paths, key))
    counts = [dr.zeros(mi.UInt32, N) for _ in range(3)]
    sums = [dr.zeros(mi.Float, N) for _ in range(3)]
    chains = Chains(u, color, indirect, value, pixel, dr.full(mi.Bool, True, N), *sums, *counts, count)
    films = Films(dr.zeros(mi.Float, 6 * pixels), *(dr.zeros(mi.Float, 3 * pixels) for _ in range(4)))
    dr.make_opaque(chains, films)  # data: a recorded step then fits from the first one on
    return chains, films


def step(picture: Picture, chains: Chains, films: Films, law: Law, first, key) -> Chains:
    """One mutation of every chain; `first` is b₀. Two kernels: the first traces and splats, the second moves u."""
    lane = dr.arange(mi.UInt32, dr.width(chains.value))
    choice, chance, _ = hashed(lane + CHOICE, key)
    large = choice < law.large

    def number(dimension):
        index = dimension * chains.count + lane
        return mutated(dr.gather(mi.Float, chains.u, index), index, key, large, law.smallest, law.largest)

    color, indirect, value, pixel = light_of(picture, number)
    a = dr.select(value < chains.value, value / chains.value, 1)
    accepted = chance < a
    stayed = chains.weight + (1 - a) / (chains.value / first + law.large)
    moved = a / (value / first + law.large)

    # On the film comes the state that is left, or the proposal that is not taken.
    made = dr.select(accepted, large if law.replaced else chains.large, large)
    weight = dr.select(accepted, stayed, moved)
    where = dr.select(accepted, chains.pixel, pixel)
    _add(films.chains, 2 * where + dr.select(made, 0, 1), dr.select(accepted, chains.color, color) * weight)
    _add(films.chains_indirect, where, dr.select(accepted, chains.indirect, indirect) * weight)
    shared = 1 / (value / first + law.large)
    _add(films.large, pixel, color * shared, large)
    _add(films.large_indirect, pixel, indirect * shared, large)
    _add(films.proposals, pixel, color, large)

    one = mi.UInt32(1)
    after = Chains(
        u=chains.u,
        color=dr.select(accepted, color, chains.color),
        indirect=dr.select(accepted, indirect, chains.indirect),
        value=dr.select(accepted, value, chains.value),
        pixel=dr.select(accepted, pixel, chains.pixel),
        large=dr.select(accepted, large, chains.large),
        weight=dr.select(accepted, moved, stayed),
        total=chains.total + dr.select(large, value, 0),
        squares=chains.squares + dr.select(large, value * value, 0),
        proposed=chains.proposed + dr.select(large, one, 0),
        taken_large=chains.taken_large + dr.select(large & accepted, one, 0),
        taken_small=chains.taken_small + dr.select(~large & accepted, one, 0),
        count=chains.count,
    )
    dr.eval(after, accepted, large, films)

    lane, dimension = _lanes(dr.width(chains.u), chains.count)
    taken, fresh_ones = dr.gather(mi.Bool, accepted, lane), dr.gather(mi.Bool, large, lane)
    proposal = mutated(chains.u, dimension * chains.count + lane, key, fresh_ones, law.smallest, law.largest)
    after.u = dr.select(taken, proposal, chains.u)
    dr.eval(after.u)
    return after


def _lanes(numbers: int, count):
    """(chain, dimension) of every number in u, with `count` chains."""
    index = dr.arange(mi.UInt32, numbers)
    dimension = index // count
    return index - dimension * count, dimension


def _add(film, index, light, active=True) -> None:
    for k in range(3):
        dr.scatter_add(film, light[k], 3 * index + k, active)


def finish(chains: Chains, films: Films) -> None:
    """Put the light of the last states on the films."""
    _add(films.chains, 2 * chains.pixel + dr.select(chains.large, 0, 1), chains.color * chains.weight)
    _add(films.chains_indirect, chains.pixel, chains.indirect * chains.weight)
    dr.eval(films)


def walk(picture: Picture, count: int, steps: int, law: Law, key: tuple[int, ...]):
    """(chains, films, luminances of the bootstrap, b₀) after `steps` mutations of `count` chains.

    Chains and films are None where the bootstrap finds no light.
    """
    paths, start = max(PATHS_PER_CHAIN * count, MIN_PATHS), stream_seed(*key, 0)
    values = bootstrap(picture, paths, start)
    first = float(values.mean())
    if not first > 0:
        return None, None, values, first
    chosen = seeds(values, count, np.random.default_rng([*key, 1]).uniform())
    keys = [stream_seed(*key, 2, k) for k in range(steps)]
    begun = (picture, chosen, paths, start)
    try:
        chains, films = _walk(dr.freeze(step), begun, law, first, keys)
    except RuntimeError:  # a scene that cannot be recorded: the Python function is traced at every step
        chains, films = _walk(step, begun, law, first, keys)
    finish(chains, films)
    return chains, films, values, first


def _walk(step, begun: tuple, law: Law, first: float, keys: list[int]) -> tuple[Chains, Films]:
    (chains, films), first = begin(*begun), dr.opaque(mi.Float, first)
    with _no_collection():
        for key in keys:
            chains = step(begun[0], chains, films, law, first, dr.opaque(mi.UInt32, key))
    return chains, films


@contextmanager
def _no_collection():
    """No garbage is collected: Dr.Jit 1.5 ends the process where a left-over scene is freed during a recording."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
