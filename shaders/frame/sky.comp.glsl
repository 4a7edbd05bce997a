#version 430
// A sky without noise stays as it is (ops.even_sky): a pixel that shows it keeps its radiance x where there are open pixels in
// its block and the 8 blocks around it, and these are all within x · (1 ± SKY_TOLERANCE).
#pragma constants SKY_BLOCK SKY_TOLERANCE
#include "image.glsl"
#pragma reads vec4 light, vec4 surface    // [H, W] rgb; normal, depth
#pragma reads vec4 lowest, vec4 highest   // [⌈H/8⌉, ⌈W/8⌉] rgb of `sky_blocks`
#pragma writes vec4 denoised              // [H, W] rgb: for history
#pragma writes float result               // [3, H, W]: the same
#include "open_sky.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size) || !shows_sky(pixel)) return;

    ivec2 blocks = (size + SKY_BLOCK - 1) / SKY_BLOCK, block = pixel / SKY_BLOCK;
    int i = at(pixel, size), plane = size.x * size.y;
    vec3 rgb = light[i].rgb, margin = SKY_TOLERANCE * rgb;
    bool found = false;
    for (int k = 0; k < 9; ++k) {
        ivec2 b = block + ivec2(k % 3, k / 3) - 1;
        if (!inside(b, blocks)) continue;
        vec3 low = lowest[at(b, blocks)].rgb, high = highest[at(b, blocks)].rgb;
        if (any(greaterThan(high - rgb, margin)) || any(greaterThan(rgb - low, margin))) return;
        found = found || low.r <= high.r;
    }
    if (!found) return;
    denoised[i] = vec4(rgb, 1.0);
    for (int c = 0; c < 3; ++c) result[c * plane + i] = rgb[c];
}
