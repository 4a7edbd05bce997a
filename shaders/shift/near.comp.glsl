#version 430
// Blocks in and beside which depth is that of one surface (shift.light.one_surface): 1. With EVEN only those in or beside which
// light is even, too; `edges` tells whether there is an edge of light in one of them.
#pragma constants EVEN SHIFT_EVEN SHIFT_CONTRAST DEPTH_TOLERANCE
#include "image.glsl"

#pragma reads vec4 blocks    // [H, W] of `blocks`
#pragma writes float near    // [H, W]
#pragma changes uint edges   // [1], 0 before

void main() {
    ivec2 block = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(block, size)) return;

    bool even = false;
    float far = 0.0, nearest = 3e38, greatest = 0.0, least = 3e38;
    for (int k = 0; k < 9; ++k) {
        ivec2 b = block + ivec2(k % 3, k / 3) - 1;
        if (!inside(b, size)) continue;
        vec4 its = blocks[at(b, size)];
        even = even || (its.y <= (1.0 + SHIFT_EVEN) * its.x && its.x > 0.0);
        greatest = max(greatest, its.y);
        least = min(least, its.x);
        far = max(far, its.z);
        nearest = min(nearest, its.w);
    }
    bool counts = far - nearest <= DEPTH_TOLERANCE * far && (EVEN == 0 || even);
    near[at(block, size)] = counts ? 1.0 : 0.0;
    if (EVEN == 1 && counts && greatest > SHIFT_CONTRAST * least) atomicOr(edges[0], 1u);
}
