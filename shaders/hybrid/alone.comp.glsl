#version 430
// The depths of lone samples (ops.scattered): of those that hit something, and whose depth is that of SCATTERED_ALIKE of the
// eight pixels around at most.
#pragma constants DEPTH_TOLERANCE SCATTERED_ALIKE
#include "image.glsl"

#pragma reads vec4 surface  // [H, W] normal, depth
#pragma writes float alone  // [H, W] 0: there is none

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    float depth = surface[at(pixel, size)].w;
    int near = 0;
    for (int k = 0; k < 9; ++k) {
        ivec2 p = clamp(pixel + ivec2(k % 3 - 1, k / 3 - 1), ivec2(0), size - 1);
        float other = surface[at(p, size)].w;
        if (k != 4 && abs(depth - other) <= DEPTH_TOLERANCE * max(depth, other)) ++near;
    }
    alone[at(pixel, size)] = near <= SCATTERED_ALIKE ? depth : 0.0;
}
