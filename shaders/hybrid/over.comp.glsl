#version 430
// Edges that move against what is behind them (ops.over): the front over what is behind, as a kept frame saw it cover each
// pixel. The FIRST dispatch finds the edges and adds this frame, the LAST writes the footprints; elsewhere they stay.
#pragma constants FIRST LAST DEPTH_TOLERANCE OVER_APART OVER_SPEED RECALL_SAME OVER_LIGHT
#include "image.glsl"
#include "albedo.glsl"
#include "beside.glsl"
#include "kept.glsl"

#pragma reads vec4 seen                             // [3, H, W] as `see` writes it
#pragma reads vec4 light, vec4 guide, vec4 surface  // [H, W]
#pragma reads vec4 vectors                          // [H, W] motion, motion_next
#pragma changes vec4 front                          // [H, W] motion to the kept frame, share left, weights
#pragma changes vec4 over                           // [3, H, W] sums, or at last as `seen`

// The motion of the front in the first pixel beside that saw it in the kept frame; off the screen where none did.
vec2 front_beside(ivec2 pixel, float least, float between) {
    for (int k = 1; k < 5; ++k) {
        KeptPixel other = kept_at(beside(pixel, k));
        float away = distance_of(other.surface.w);
        if (away >= least && away < between) return other.motion;
    }
    return vec2(FAR_AWAY);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    // The nearest and the farthest of the pixel and the four beside it.
    int i = at(pixel, size), plane = size.x * size.y, nearest = i, farthest = i;
    float own = distance_of(surface[i].w), near = own, far = own;
    for (int k = 1; k < 5; ++k) {
        int j = at(beside(pixel, k), size);
        float other = distance_of(surface[j].w);
        if (other < (1.0 - OVER_APART) * near) { near = other; nearest = j; }
        if ((1.0 - OVER_APART) * other > far) { far = other; farthest = j; }
    }
    // The FIRST decides for the others, where another rounding might decide otherwise: no weights, no edge.
    bool edge = FIRST == 0 && front[i].w != 0.0;
    if (FIRST == 1) {
        vec2 apart = vectors[nearest].xy - vectors[farthest].xy;
        edge = near < (1.0 - OVER_APART) * far && dot(apart, apart) > OVER_SPEED * OVER_SPEED;
    }
    if (!edge) {
        if (FIRST == 1) front[i] = vec4(0.0);
        if (LAST == 1)
            for (int k = 0; k < 3; ++k) over[i + k * plane] = seen[i + k * plane];
        return;
    }
    float between = far == NOWHERE ? 2.0 * near : sqrt(near) * sqrt(far);
    mat3 total;  // rgb, albedo, normal
    mat3 back = mat3(seen[farthest].rgb, seen[farthest + plane].rgb, seen[farthest + 2 * plane].xyz);
    vec4 come;
    if (FIRST == 1) {
        total = own < between ? mat3(light[i].rgb * divisor(guide[i]), guide[i].rgb, surface[i].xyz) : back;
        come = vec4(vectors[nearest].xy, 1.0, 1.0);
    } else {
        total = mat3(over[i].rgb, over[i + plane].rgb, over[i + 2 * plane].xyz);
        come = front[i];
    }

    vec2 motion = bounded(come.xy);
    ivec2 end = end_of(pixel, motion);
    if (inside(end, size)) {
        KeptPixel there = kept_at(end);
        float away = distance_of(there.surface.w), weight = come.z * cover(motion), least = (1.0 - DEPTH_TOLERANCE) * near;
        vec2 onward = there.motion;
        if (away < least || away >= between) onward = front_beside(end, least, between);
        if (away < least) weight = 0.0;  // something passed before both
        else if (away < between) {
            vec3 albedo = kept_edge_at(end).albedo;
            vec3 rgb = there.light * divisor(vec4(albedo, there.surface.w));
            total += weight * mat3(rgb, albedo, there.surface.xyz);
        } else total += weight * back;
        come = vec4(motion + onward, come.z * (1.0 - there.reset), come.w + weight);
    } else come.xy = vec2(FAR_AWAY);

    if (LAST == 1) {
        total /= come.w;
        vec3 was = seen[i].rgb;
        vec3 now = mix(total[0], was, lessThanEqual(abs(total[0] - was), RECALL_SAME * was));
        total[0] = mix(was, now, OVER_LIGHT);
    }
    front[i] = come;
    over[i] = vec4(total[0], seen[i].w);
    over[i + plane] = vec4(total[1], seen[i + plane].w);
    over[i + 2 * plane] = vec4(total[2], seen[i + 2 * plane].w);
}
