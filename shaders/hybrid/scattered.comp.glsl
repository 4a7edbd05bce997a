#version 430
// The least and the greatest depth that a sample of a scattered surface around each pixel may have (ops.scattered).
#pragma constants DEPTH_TOLERANCE SCATTERED_APART SCATTERED_REACH
#include "image.glsl"

#pragma reads float alone  // [H, W] depth of lone samples, 0 elsewhere
#pragma writes vec4 lone   // [H, W] least, greatest; 1, 0 where there is none

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    float least = 3e38, greatest = 0.0;
    ivec2 from = max(pixel - SCATTERED_REACH, ivec2(0)), to = min(pixel + SCATTERED_REACH, size - 1);
    for (int y = from.y; y <= to.y; ++y)
        for (int x = from.x; x <= to.x; ++x) {
            float depth = alone[at(ivec2(x, y), size)];
            if (depth > 0.0) least = min(least, depth);
            greatest = max(greatest, depth);
        }
    bool some = greatest > 0.0 && greatest <= SCATTERED_APART * least;
    vec2 range = vec2((1.0 - DEPTH_TOLERANCE) * least, greatest / (1.0 - DEPTH_TOLERANCE));
    lone[at(pixel, size)] = vec4(some ? range : vec2(1.0, 0.0), 0.0, 0.0);
}
