// Targets of motion vectors.
#include "finite.glsl"

#pragma reads float motion  // [B, 2, H, W] (x, y) in pixels

// pixel + motion(pixel), clamped to the pixel centres of the image; pixel (0, 0) is at (0, 0). A motion that is not finite
// counts as zero.
vec2 target(int b, ivec2 pixel) {
    float x = finite_or(motion[at(b, 0, pixel, 2, size)], 0.0);
    float y = finite_or(motion[at(b, 1, pixel, 2, size)], 0.0);
    return clamp(vec2(pixel) + vec2(x, y), vec2(0.0), vec2(size - 1));
}
