#version 430
// Compare the normals of surfaces, and their albedo, with those of the previous frame, reprojected (ops.turned, ops.retextured):
// sums over cells of TURNED_CELL² pixels, for `turned`. A work group is a row of whole cells. With STILL no surface turns.
#pragma constants STILL TURNED_CELL DEPTH_TOLERANCE MIN_NORMAL_COSINE
#include "image.glsl"

#pragma reads vec4 chosen                        // [H, W] motion
#pragma reads vec4 surface, vec4 surface_before  // [H, W] normal, depth
#pragma reads vec4 guide                         // [H, W] rgb: albedo
#pragma reads vec4 mean_albedo_before            // [H, W] rgb
#pragma writes vec4 turns                        // [⌈H/TURNED_CELL⌉, ⌈W/TURNED_CELL⌉] Σ d, Σ |d|²
#pragma writes vec4 counts                       // likewise: pixels with both normals, Σ beyond, pixels with both albedos, 0
#pragma writes vec4 aparts                       // likewise: Σ across, Σ down, 0, 0

vec4 surface_before_at(ivec2 p) {
    return surface_before[at(p, size)];
}
#include "reproject.glsl"

shared vec4 terms[GROUP_X * GROUP_Y];
shared vec4 both[GROUP_X * GROUP_Y];
shared vec2 moved[GROUP_X * GROUP_Y];

// How far albedo lies beyond that of 3×3 pixels, summed over channels.
float beyond(ivec2 pixel, vec3 albedo) {
    vec3 least = vec3(3e38), greatest = vec3(-3e38);
    for (int k = 0; k < 9; ++k) {
        ivec2 p = pixel + ivec2(k % 3, k / 3) - 1;
        if (!inside(p, size)) continue;
        least = min(least, guide[at(p, size)].rgb);
        greatest = max(greatest, guide[at(p, size)].rgb);
    }
    return dot(max(albedo - greatest, 0.0) + max(least - albedo, 0.0), vec3(1.0));
}

// How much farther from this frame's albedo than that to the right, and below, squared.
vec2 apart(ivec2 pixel, vec3 albedo) {
    vec3 now = guide[at(pixel, size)].rgb;
    vec3 right = guide[at(min(pixel + ivec2(1, 0), size - 1), size)].rgb - now;
    vec3 down = guide[at(min(pixel + ivec2(0, 1), size - 1), size)].rgb - now;
    return dot(now - albedo, now - albedo) - vec2(dot(right, right), dot(down, down));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), lane = ivec2(gl_LocalInvocationID.xy);
    int here = lane.y * GROUP_X + lane.x;
    terms[here] = vec4(0.0);
    both[here] = vec4(0.0);
    moved[here] = vec2(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        Taps taps = weigh_taps(pixel, chosen[i].xy, surface[i], DEPTH_TOLERANCE, MIN_NORMAL_COSINE);
        if (is_valid(taps)) {
            vec3 now = surface[i].xyz, before = vec3(0.0), albedo = vec3(0.0);
            for (int t = 0; t < 4; ++t) {
                if (taps.weight[t] == 0.0) continue;
                ivec2 tap = tap_pixel(taps, t);
                before += taps.weight[t] * surface_before_at(tap).xyz;
                albedo += taps.weight[t] * mean_albedo_before[at(tap, size)].rgb;
            }
            before /= taps.total;
            albedo /= taps.total;
            both[here].yz = vec2(beyond(pixel, albedo), 1.0);
            moved[here] = apart(pixel, albedo);
            float has = dot(now, now), had = dot(before, before);
            if (STILL == 0 && has > 0.0 && had > 0.0) {
                vec3 d = now / sqrt(max(has, 1e-12)) - before / sqrt(max(had, 1e-12));
                terms[here] = vec4(d, dot(d, d));
                both[here].x = 1.0;
            }
        }
    }
    barrier();
    if (lane.x % TURNED_CELL != 0 || lane.y % TURNED_CELL != 0 || !inside(pixel, size)) return;
    vec4 sum = vec4(0.0), count = vec4(0.0);
    vec2 farther = vec2(0.0);
    for (int y = 0; y < TURNED_CELL; ++y)
        for (int x = 0; x < TURNED_CELL; ++x) {
            sum += terms[here + y * GROUP_X + x];
            count += both[here + y * GROUP_X + x];
            farther += moved[here + y * GROUP_X + x];
        }
    int cell = at(pixel / TURNED_CELL, (size + TURNED_CELL - 1) / TURNED_CELL);
    turns[cell] = sum;
    counts[cell] = count;
    aparts[cell] = vec4(farther, 0.0, 0.0);
}
