#version 430
// Compare the normals of surfaces with those of the previous frame, reprojected (ops.turned): sums over cells of TURNED_CELL²
// pixels, for `turned`. A work group is a row of whole cells.
#pragma constants TURNED_CELL DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"

#pragma reads vec4 chosen                        // [H, W] motion
#pragma reads vec4 surface, vec4 surface_before  // [H, W] normal, depth
#pragma writes vec4 turns                        // [⌈H/TURNED_CELL⌉, ⌈W/TURNED_CELL⌉] Σ d, Σ |d|²
#pragma writes float counts                      // likewise: pixels that have both normals

vec4 surface_before_at(ivec2 p) {
    return surface_before[at(p, size)];
}
#include "reproject.glsl"

shared vec4 terms[GROUP_X * GROUP_Y];
shared float both[GROUP_X * GROUP_Y];

// The normal of the previous frame, of any length; 0 where the surface has no history.
vec3 normal_before(ivec2 pixel, int i) {
    vec3 normal = vec3(0.0);
    Taps taps = weigh_taps(pixel, chosen[i].xy, surface[i], DEPTH_TOLERANCE, MIN_NORMAL_COSINE);
    if (!is_valid(taps)) return normal;
    for (int t = 0; t < 4; ++t)
        if (taps.weight[t] > 0.0) normal += taps.weight[t] * surface_before_at(tap_pixel(taps, t)).xyz;
    return normal / taps.total;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), lane = ivec2(gl_LocalInvocationID.xy);
    int here = lane.y * GROUP_X + lane.x;
    terms[here] = vec4(0.0);
    both[here] = 0.0;
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 now = surface[i].xyz, before = normal_before(pixel, i);
        float has = dot(now, now), had = dot(before, before);
        if (has > 0.0 && had > 0.0) {
            vec3 d = now / sqrt(max(has, 1e-12)) - before / sqrt(max(had, 1e-12));
            terms[here] = vec4(d, dot(d, d));
            both[here] = 1.0;
        }
    }
    barrier();
    if (lane.x % TURNED_CELL != 0 || lane.y % TURNED_CELL != 0 || !inside(pixel, size)) return;
    vec4 sum = vec4(0.0);
    float count = 0.0;
    for (int y = 0; y < TURNED_CELL; ++y)
        for (int x = 0; x < TURNED_CELL; ++x) {
            sum += terms[here + y * GROUP_X + x];
            count += both[here + y * GROUP_X + x];
        }
    int cell = at(pixel / TURNED_CELL, (size + TURNED_CELL - 1) / TURNED_CELL);
    turns[cell] = sum;
    counts[cell] = count;
}
