#version 430
// The displacement of each cell (shift.displacement.displacement): least squares over it and the eight around it. The FIRST
// round starts at 0; each says which share of the pictures' squared difference is left.
#pragma constants FIRST CELL SHIFT_STRIDE DAMPING SHIFT_AROUND
#include "image.glsl"

#pragma reads vec4 sums     // [2, h, w] of `sums`
#pragma changes vec4 shift  // [h, w] pixels (x, y), e² of the first round, share of it that is left

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;

    vec4 a = vec4(0.0), b = vec4(0.0);
    for (int y = 0; y < SHIFT_AROUND; ++y)
        for (int x = 0; x < SHIFT_AROUND; ++x) {
            ivec2 c = cell + ivec2(x, y) - SHIFT_AROUND / 2;
            if (!inside(c, size)) continue;
            a += sums[at(c, size)];
            b += sums[at(c, size) + size.x * size.y];
        }
    float xx = a.y + DAMPING * a.x + 1e-6, yy = a.w + DAMPING * a.x + 1e-6, xy = a.z;
    vec2 change = vec2(yy * b.x - xy * b.y, xx * b.y - xy * b.x) / (xx * yy - xy * xy);
    if (a.x <= float(CELL * SHIFT_AROUND) / float(SHIFT_STRIDE * SHIFT_STRIDE)) change = vec2(0.0);
    int i = at(cell, size);
    vec4 before = FIRST == 1 ? vec4(0.0, 0.0, b.z, 0.0) : shift[i];
    shift[i] = vec4(before.xy + change, before.z, (b.z - dot(change, b.xy)) / max(before.z, 1e-30));
}
