#version 430
// The least and the greatest light of two pictures in each cell, for `written`; one work group per cell.
#include "around.glsl"
#include "extremes.glsl"
#include "grey.glsl"

#pragma reads vec4 even, vec4 denoised  // [H, W] with grey in it, without
#pragma writes vec4 bounds              // [2, ⌈H/AROUND_CELL⌉, ⌈W/AROUND_CELL⌉] least, greatest

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex), i = at(pixel, size);
    low[lane] = vec3(3e38);
    high[lane] = vec3(0.0);
    if (inside(pixel, size)) {
        vec3 grey = greyed(denoised[i].rgb);
        low[lane] = min(even[i].rgb, grey);
        high[lane] = max(even[i].rgb, grey);
    }
    reduce_extremes(lane);
    if (lane == 0) {
        ivec2 extent = cells_of(size), cell = ivec2(gl_WorkGroupID.xy);
        bounds[at(cell, extent)] = vec4(low[0], 0.0);
        bounds[at(cell, extent) + extent.x * extent.y] = vec4(high[0], 0.0);
    }
}
