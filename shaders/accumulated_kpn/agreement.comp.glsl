#version 430
// How far what was seen before agrees with this frame (ops.outdated): the greatest over cells of OUTDATED_RIM² pixels. With
// RECALLS the count of recent frames tells what agrees, else the test of the running mean.
#pragma constants RECALLS RECALL_CELL OUTDATED_RIM
#include "image.glsl"

#pragma reads vec4 running      // [H, W] rgb, count
#pragma reads float stays       // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] how far the running mean agrees
#pragma reads vec4 mean_albedo  // [H, W] rgb, whether the surface was there
#pragma writes vec2 most        // [⌈H/OUTDATED_RIM⌉, ⌈W/OUTDATED_RIM⌉] what agrees, whether the surface was there
#pragma parameters ivec2 image_size

float agrees(ivec2 pixel, int i) {
    return RECALLS == 1 ? running[i].w : stays[at(pixel / RECALL_CELL, (image_size + RECALL_CELL - 1) / RECALL_CELL)];
}

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(cell, size)) return;
    vec2 greatest = vec2(0.0);
    for (int k = 0; k < OUTDATED_RIM * OUTDATED_RIM; ++k) {
        ivec2 pixel = OUTDATED_RIM * cell + ivec2(k % OUTDATED_RIM, k / OUTDATED_RIM);
        if (!inside(pixel, image_size)) continue;
        int i = at(pixel, image_size);
        greatest = max(greatest, vec2(agrees(pixel, i), mean_albedo[i].w));
    }
    most[at(cell, size)] = greatest;
}
