#version 430
// Add to each pixel's footprint what a kept frame saw in it (ops.recall): along the path of the edge in it, as far as light has
// stayed as it is (`accumulated_kpn/stays`). The FIRST dispatch starts from nothing, the LAST divides by the weights.
//
// With DUAL 0 nothing has been uncovered, with LONE 0 nothing is scattered.
#pragma constants FIRST LAST DUAL LONE RECALL_CELL MIN_NORMAL_COSINE
#include "image.glsl"
#include "albedo.glsl"
#include "alike.glsl"
#include "kept.glsl"

#pragma reads vec4 surface     // [H, W] normal, depth
#pragma reads vec4 chosen      // [H, W] motion to the frame before, uncovered
#pragma reads float stays      // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉]
#pragma reads float level      // [2] of `hybrid/level`
#pragma reads vec4 lone        // [H, W] least and greatest depth of what is scattered around (`scattered`)
#pragma changes vec4 edge      // [H, W] motion to the kept frame, share that resets left, distance of what is followed
#pragma changes vec4 seen      // [3, H, W] rgb, frames · albedo · normal

vec2 motion_at(ivec2 pixel) {
    return chosen[at(pixel, size)].xy;
}
#include "edge_motion.glsl"

bool shown_beside(ivec2 pixel, vec4 other) {
    for (int k = 0; k < 5; ++k)
        if (alike(surface[at(beside(pixel, k), size)], other, DEPTH_TOLERANCE, MIN_NORMAL_COSINE)) return true;
    return false;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), plane = size.x * size.y;
    vec4 light = vec4(0.0), albedo = vec4(0.0), normal = vec4(0.0), come = edge[i];
    if (FIRST == 1) {
        vec3 begin = edge_motion(pixel);
        come = vec4(begin.xy, 1.0, begin.z);
    } else {
        light = seen[i];
        albedo = seen[i + plane];
        normal = seen[i + 2 * plane];
    }
    vec2 motion = bounded(come.xy);
    ivec2 end = end_of(pixel, motion);
    vec4 on = vec4(FAR_AWAY, FAR_AWAY, come.zw);
    if (inside(end, size)) {
        KeptPixel there = kept_at(end);
        KeptEdge at_edge = kept_edge_at(end);
        vec2 apart = motion - roundEven(motion);
        bool uncovered = DUAL == 1 && chosen[i].z != 0.0;
        bool in_front = distance_of(there.surface.w) < (1.0 - DEPTH_TOLERANCE) * come.w;
        bool is_lone = LONE == 1 && there.surface.w >= lone[i].x && there.surface.w <= lone[i].y;
        if (!uncovered && (is_lone || !in_front && shown_beside(pixel, there.surface))) {
            float weight = come.z * stays[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)] * cover(motion) /
                           (1.0 + level[0] * dot(apart, apart));
            vec3 radiance = there.light * divisor(vec4(at_edge.albedo, there.surface.w));
            light += weight * vec4(radiance, 1.0);
            albedo.rgb += weight * at_edge.albedo;
            normal.xyz += weight * there.surface.xyz;
        }
        on.xyz = vec3(motion + at_edge.motion, come.z * (1.0 - there.reset));
    }
    edge[i] = on;
    if (LAST == 1) {
        float weights = max(light.w, 1e-6);
        light.rgb /= weights;
        albedo /= weights;
        normal /= weights;
    }
    seen[i] = light;
    seen[i + plane] = albedo;
    seen[i + 2 * plane] = normal;
}
