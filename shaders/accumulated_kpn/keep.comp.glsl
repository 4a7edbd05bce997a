#version 430
// A frame as later ones recall it (ops.recall.keep): its light, surface and motion in bfloat16. Without motion (MOVES 0) paths
// end at it. `forget` adds the reset.
#pragma constants MOVES FAR_AWAY
#include "image.glsl"
#include "bfloat16.glsl"

#pragma reads vec4 light, vec4 surface  // [H, W] rgb; normal, depth
#pragma reads vec4 vectors              // [H, W] motion, motion_next
#pragma writes uint kept                // [5, H, W] red, green · blue, depth · normal x, y · normal z, 0 · motion

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size), plane = size.x * size.y;
    vec3 rgb = light[i].rgb;
    vec4 here = surface[i];
    vec2 motion = MOVES == 1 ? vectors[i].xy : vec2(FAR_AWAY);
    kept[i] = packed_two(rgb.r, rgb.g);
    kept[i + plane] = packed_two(rgb.b, here.w);
    kept[i + 2 * plane] = packed_two(here.x, here.y);
    kept[i + 3 * plane] = packed_two(here.z, 0.0);
    kept[i + 4 * plane] = packed_two(motion.x, motion.y);
}
