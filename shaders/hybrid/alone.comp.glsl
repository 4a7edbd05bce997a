#version 430
// The depths of lone samples (ops.scattered): of those that hit something, and whose depth is that of SCATTERED_ALIKE of the
// eight pixels around at most, and those are no more crowded.
#pragma constants DEPTH_TOLERANCE SCATTERED_ALIKE
#include "image.glsl"

#pragma reads vec4 surface  // [H, W] normal, depth
#pragma writes float alone  // [H, W] 0: there is none

ivec2 around(ivec2 pixel, int k) {
    return clamp(pixel + ivec2(k % 3 - 1, k / 3 - 1), ivec2(0), size - 1);
}

bool alike_in_depth(ivec2 pixel, ivec2 other) {
    float a = surface[at(pixel, size)].w, b = surface[at(other, size)].w;
    return abs(a - b) <= DEPTH_TOLERANCE * max(a, b);
}

bool crowded(ivec2 pixel) {
    int near = 0;
    for (int k = 0; k < 9; ++k)
        if (k != 4 && alike_in_depth(pixel, around(pixel, k))) ++near;
    return near > SCATTERED_ALIKE;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    bool is_alone = !crowded(pixel);
    for (int k = 0; k < 9 && is_alone; ++k) {
        ivec2 p = around(pixel, k);
        is_alone = k == 4 || !alike_in_depth(pixel, p) || !crowded(p);
    }
    alone[at(pixel, size)] = is_alone ? surface[at(pixel, size)].w : 0.0;
}
