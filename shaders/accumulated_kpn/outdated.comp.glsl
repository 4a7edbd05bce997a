#version 430
// Where light has changed so much that the frames before do not tell of it (ops.outdated), over cells of OUTDATED_CELL² pixels, a
// work group each: history gives way by the share
//
//     1 - min(1, greatest of what agrees)
//
// and from OUTDATED_PICTURE on the previous output is as if it were off the screen. 0 in cells whose surfaces are all new. With
// RECALLS the count of recent frames tells what agrees, else the test of the running mean.
#pragma constants RECALLS OUTDATED_PICTURE RECALL_CELL TURNED_CELL
#include "image.glsl"
#include "past.glsl"

#pragma reads vec4 running      // [H, W] rgb, count
#pragma reads float stays       // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] how far the running mean agrees
#pragma reads vec4 mean_albedo  // [H, W] rgb, whether the surface was there
#pragma reads vec4 noisy        // [H, W] rgb: radiance
#pragma reads vec4 before       // [H, W] rgb, flags: the previous output, reprojected
#pragma writes vec4 past        // [H, W] the same, or noisy radiance without ON_SCREEN
#pragma changes float turned    // [⌈H/TURNED_CELL⌉, ⌈W/TURNED_CELL⌉] the share that gives way

shared vec2 most[GROUP_X * GROUP_Y];  // what agrees, whether the surface was there

float agrees(ivec2 pixel, int i) {
    return RECALLS == 1 ? running[i].w : stays[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)];
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex), i = at(pixel, size);
    bool has = inside(pixel, size);
    most[lane] = has ? vec2(agrees(pixel, i), mean_albedo[i].w) : vec2(0.0);
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) most[lane] = max(most[lane], most[lane + step]);
    }
    barrier();
    if (!has) return;
    float share = most[0].y * max(1.0 - most[0].x, 0.0);
    past[i] = share < OUTDATED_PICTURE ? before[i] : vec4(noisy[i].rgb, float(int(before[i].w) & ~ON_SCREEN));
    if (pixel.x % TURNED_CELL != 0 || pixel.y % TURNED_CELL != 0) return;
    int cell = at(pixel / TURNED_CELL, (size + TURNED_CELL - 1) / TURNED_CELL);
    turned[cell] += (1.0 - turned[cell]) * share;
}
