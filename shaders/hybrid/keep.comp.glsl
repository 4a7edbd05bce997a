#version 430
// What `hybrid` keeps of a frame beside the words of `accumulated_kpn/keep`: its albedo and the motion of its edges.
#pragma constants MOVES FAR_AWAY
#include "image.glsl"
#include "bfloat16.glsl"

#pragma reads vec4 guide, vec4 surface  // [H, W] albedo; normal, depth
#pragma reads vec4 vectors              // [H, W] motion, motion_next
#pragma changes uint kept               // [8, H, W] 5 words of `keep` · red, green · blue, edge x · edge y, 0

vec2 motion_at(ivec2 pixel) {
    return MOVES == 1 ? vectors[at(pixel, size)].xy : vec2(FAR_AWAY);
}
#include "edge_motion.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), plane = size.x * size.y;
    vec3 albedo = guide[i].rgb;
    vec2 edge = edge_motion(pixel).xy;
    kept[i + 5 * plane] = packed_two(albedo.r, albedo.g);
    kept[i + 6 * plane] = packed_two(albedo.b, edge.x);
    kept[i + 7 * plane] = packed_two(edge.y, 0.0);
}
