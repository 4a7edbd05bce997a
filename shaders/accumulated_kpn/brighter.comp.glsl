#version 430
// How much brighter light has become in squares of SIDE × SIDE cells (ops.relit):
//
//     g = clamp((q - RELIT_FROM) / (RELIT_WHOLE - RELIT_FROM), 0, 1) · log clamp(Σ now / Σ before, 1/RELIT_MOST, RELIT_MOST)
//     q = |Σ d|² / (Σ |d|² + |RELIT_ROUNDING Σ before|²) / (RELIT_DARKER where Σ now < Σ before, else 1)
//
// with d the sums of before - now over the quarters of squares, of a square and the eight around it. Unless FIRST, before is as
// bright as `first` says.
#pragma constants FIRST SIDE RELIT_ROUNDING RELIT_DARKER RELIT_FROM RELIT_WHOLE RELIT_MOST
#pragma parameters ivec2 extent
#include "image.glsl"
#include "cells.glsl"

#pragma reads vec4 cells   // [2, extent] sums of before, of now
#pragma reads vec4 first   // squares of 2 SIDE × 2 SIDE cells, likewise; not with FIRST
#pragma writes vec4 gains  // [h, w] g

const int FIRST_SIDE = 2 * SIDE;
SPREAD(g_before, first, FIRST_SIDE)

// Sums over a quarter of a square.
void sum_quarter(ivec2 quarter, out vec3 before, out vec3 now) {
    const int side = SIDE / 2;
    before = now = vec3(0.0);
    for (int k = 0; k < side * side; ++k) {
        ivec2 cell = quarter * side + ivec2(k % side, k / side);
        if (!inside(cell, extent)) continue;
        int i = at(cell, extent);
        before += FIRST == 1 ? cells[i].rgb : cells[i].rgb * exp(g_before(cell, extent));
        now += cells[i + extent.x * extent.y].rgb;
    }
}

void main() {
    ivec2 square = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(square, size)) return;
    vec3 sum = vec3(0.0), sum_now = vec3(0.0), before, now;
    for (int k = 0; k < 36; ++k) {
        sum_quarter(2 * square - 2 + ivec2(k % 6, k / 6), before, now);
        sum += before;
        sum_now += now;
    }
    // Squares of light itself may be infinite.
    float share = 1.0 / max(dot(sum + sum_now, vec3(1.0)), 1e-30), noise = 0.0;
    for (int k = 0; k < 36; ++k) {
        sum_quarter(2 * square - 2 + ivec2(k % 6, k / 6), before, now);
        vec3 d = share * (before - now);
        noise += dot(d, d);
    }
    vec3 apart = share * (sum - sum_now), least = RELIT_ROUNDING * share * sum, times = vec3(1.0);
    noise += dot(least, least);
    float q = dot(apart, apart) / max(noise, 1e-30);
    if (dot(sum_now, vec3(1.0)) < dot(sum, vec3(1.0))) q /= RELIT_DARKER;
    float sure = clamp((q - RELIT_FROM) / (RELIT_WHOLE - RELIT_FROM), 0.0, 1.0);
    for (int c = 0; c < 3; ++c)
        if (sum[c] > 0.0) times[c] = clamp(sum_now[c] / sum[c], 1.0 / RELIT_MOST, RELIT_MOST);
    gains[at(square, size)] = vec4(sure * log(times), 0.0);
}
