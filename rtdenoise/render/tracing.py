"""The path tracer, written against Mitsuba's Python interface. Import it only after a Mitsuba variant has been set.

Light is split by the number of surface bounces between the lamp and the camera, specular ones included:
0 and 1 bounces are *direct* (lamps seen by the camera, and light that a lamp throws on the first surface hit),
2 and more are *indirect*. A lamp seen in a mirror is direct, a lit wall seen in a mirror or through glass is indirect.
Nothing is counted twice and nothing is lost: direct + indirect is what Mitsuba's `path` integrator computes.

With `holes`, surfaces let light through where their opacity (Mitsuba's `mask`) says so: paths, shadow rays and features
pass a hole without a bounce, and features and light of a sample pass the same holes. Mitsuba's `path` counts each hole
as a bounce, and holes cast shadows in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dr.syntax
def trace(scene, sampler, ray, max_depth, holes=False):
    """Path tracing with emitter and BSDF sampling (balance heuristic). `max_depth` counts edges, as Mitsuba's `path`.

    Returns (direct, indirect), two `Color3f` as wide as `ray`.
    """
    context = mi.BSDFContext()
    ray = mi.Ray3f(ray)
    max_depth = dr.opaque(mi.UInt32, max_depth)
    depth = mi.UInt32(0)  # surface bounces so far
    throughput = mi.Color3f(1)
    direct, indirect = mi.Color3f(0), mi.Color3f(0)
    previous = dr.zeros(mi.Interaction3f)  # the vertex the ray left from,
    previous_pdf, previous_delta = mi.Float(1), mi.Bool(True)  # and how its direction was sampled there
    active = mi.Bool(True)

    while active:
        si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)

        # A lamp hit by chance: weighted against having sampled it on purpose.
        hit = mi.DirectionSample3f(scene, si, previous)
        chosen = scene.pdf_emitter_direction(previous, hit, active & ~previous_delta)
        weight = dr.select(previous_delta, 1, previous_pdf / dr.maximum(previous_pdf + chosen, 1e-30))
        light = throughput * weight * hit.emitter.eval(si, active)

        # A lamp sampled on purpose, and the next direction, with one look at the BSDF.
        shade = active & si.is_valid() & (depth + 1 < max_depth)
        bsdf = si.bsdf(ray)
        smooth = shade & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        lamp, radiance = scene.sample_emitter_direction(si, sampler.next_2d(shade), not holes, smooth)
        use_lamp = smooth & (lamp.pdf > 0)
        if dr.hint(holes, mode="scalar"):
            radiance *= transmittance(scene, si, lamp, use_lamp)
        value, value_pdf, sample, factor = bsdf.eval_pdf_sample(
            context, si, si.to_local(lamp.d), sampler.next_1d(shade), sampler.next_2d(shade), shade
        )
        chance = dr.select(lamp.delta, 0, value_pdf)
        balance = lamp.pdf / dr.maximum(lamp.pdf + chance, 1e-30)
        bounced = dr.select(use_lamp, throughput * value * radiance * balance, 0)

        first = depth == 0
        direct += dr.select(depth <= 1, light, 0) + dr.select(first, bounced, 0)
        indirect += dr.select(depth <= 1, 0, light) + dr.select(first, 0, bounced)

        throughput *= factor
        ray = si.spawn_ray(si.to_world(sample.wo))
        bounce = mi.Bool(True)
        if dr.hint(holes, mode="scalar"):
            bounce = ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        previous = dr.select(bounce, mi.Interaction3f(si), previous)
        previous_pdf = dr.select(bounce, sample.pdf, previous_pdf)
        previous_delta = dr.select(bounce, mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta), previous_delta)
        depth += dr.select(bounce, mi.UInt32(1), mi.UInt32(0))
        active = shade & (dr.max(throughput) > 0)
    return _finite(direct), _finite(indirect)


@dr.syntax
def transmittance(scene, si, lamp, active):
    """The share of light from an emitter sample that the holes of the surfaces in between let through, as `Float`."""
    share = mi.Float(1)
    ray = si.spawn_ray_to(lamp.p)
    active = mi.Bool(active)
    while active:
        hit = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        active &= hit.is_valid()
        through = dr.mean(hit.bsdf().eval_null_transmission(hit, active))
        share = dr.select(active, share * through, share)
        active &= share > 0
        ray = hit.spawn_ray_to(lamp.p)
    return share


@dr.syntax
def first_surface(scene, sampler, ray):
    """The first hits of the rays behind the holes that `trace` passes with the same random numbers."""
    ray = mi.Ray3f(ray)
    si = scene.ray_intersect(ray)
    passing = si.is_valid()
    while passing:
        bsdf = si.bsdf()
        sampler.next_2d(passing)  # the emitter sample in `trace`
        sample, _ = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(passing), sampler.next_2d(passing), passing)
        passing &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        if passing:
            ray = si.spawn_ray(ray.d)
            si = scene.ray_intersect(ray, mi.RayFlags.All, False, passing)
            passing &= si.is_valid()
    return si


def _finite(radiance):
    """Paths with numerical errors contribute nothing."""
    return dr.select(dr.all(dr.isfinite(radiance)), radiance, 0)


def first_hit(scene, ray, sampler, object_ids, holes=False):
    """Features of the primary rays' hits: position, shading normal, distance, albedo, object id, emission.

    `object_ids` maps Mitsuba's shape registry ids to ours. Albedo is the diffuse reflectance where there is a diffuse
    lobe, 1 for glass, and the specular reflectance for metals (where it has no name, the weight of one BSDF sample,
    which is about reflectance × Fresnel). Position, normal, distance and id are 0 where nothing was hit.
    """
    si = first_surface(scene, sampler, ray) if holes else scene.ray_intersect(ray)
    hit = si.is_valid()
    bsdf = si.bsdf(ray)
    flags = bsdf.flags()
    diffuse = mi.has_flag(flags, mi.BSDFFlags.DiffuseReflection) | mi.has_flag(flags, mi.BSDFFlags.DiffuseTransmission)
    glass = mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission) | mi.has_flag(flags, mi.BSDFFlags.GlossyTransmission)
    metal = hit & ~diffuse & ~glass
    _, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), metal)
    tinted = bsdf.has_attribute("specular_reflectance", metal)
    specular = dr.select(tinted, bsdf.eval_attribute("specular_reflectance", si, metal & tinted), weight)
    albedo = dr.select(diffuse, bsdf.eval_diffuse_reflectance(si, hit & diffuse), dr.select(glass, 1, specular))
    emission = si.emitter(scene).eval(si)
    shape = dr.select(hit, dr.reinterpret_array(mi.UInt32, si.shape), 0)
    return {
        "albedo": dr.select(hit, albedo, 0),
        "normal": dr.select(hit, si.sh_frame.n, 0),
        "depth": dr.select(hit, si.t, 0),
        "position": dr.select(hit, si.p, 0),
        "id": dr.gather(mi.UInt32, object_ids, shape, hit),
        "emission": emission,
    }


def primary_rays(sampler, size, spp, camera):
    """Rays through every pixel, `spp` neighbours in the wavefront to a pixel, uniformly over its area (box filter) and
    over the camera's lens."""
    height, width = size
    index = dr.arange(mi.UInt32, height * width * spp) // dr.opaque(mi.UInt32, spp)
    columns = dr.opaque(mi.UInt32, width)
    y = index // columns
    x = index - y * columns
    offset = sampler.next_2d()
    return rays_through(mi.Float(x) + offset.x, mi.Float(y) + offset.y, sampler, view_of(camera, size))


@dataclass
class View:
    """A camera and its picture as data, not code, so that kernels are reused."""

    origin: mi.Point3f
    rows: list[mi.Vector3f]  # of the matrix: direction = matrix · (x, y, 1)
    lens: bool
    right: mi.Vector3f
    down: mi.Vector3f
    aperture: mi.Float
    focus: mi.Float


def view_of(camera, size) -> View:
    origin, matrix = camera.world_from_pixel(size)
    rows = [_opaque(mi.Vector3f, row) for row in matrix]
    right, down = (_opaque(mi.Vector3f, camera.to_world[:3, k]) for k in (0, 1))
    aperture, focus = (dr.opaque(mi.Float, float(v)) for v in (camera.aperture, camera.focus))
    return View(_opaque(mi.Point3f, origin), rows, camera.aperture > 0, right, down, aperture, focus)


def rays_through(x, y, sampler, view):
    """Rays through points of the picture, in pixels, and points of the lens."""
    pixel = mi.Vector3f(x, y, 1)
    direction = mi.Vector3f(*(dr.dot(row, pixel) for row in view.rows))
    origin = view.origin
    if view.lens:
        lens = mi.warp.square_to_uniform_disk(sampler.next_2d()) * view.aperture
        sharp = origin + direction * view.focus
        origin = origin + view.right * lens.x + view.down * lens.y
        direction = sharp - origin
    return mi.Ray3f(origin, dr.normalize(direction))


def _opaque(kind, values):
    """Data, not code, so that kernels are reused."""
    return kind(*(dr.opaque(mi.Float, float(v)) for v in values))


def make_sampler(seed: int, wavefront: int):
    """An independent random stream; the seed is data, not code, so that kernels are reused."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), wavefront)
    return sampler
