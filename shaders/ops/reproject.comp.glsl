#version 430
// Reprojection that takes no tap from another surface or from off the screen, and says where no tap was left:
//
//     out(p) = Σ_t b_t v_t stored(t) / Σ_t b_t v_t          over the four pixels t around p + motion(p)
//
// with the bilinear weights b_t, and v_t = 1 where t is on the screen and shows a surface `alike` the one at p. Where Σ b v is
// below MIN_HISTORY_WEIGHT the result is 0 and not valid.
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma parameters vec2 tolerance                       // of depth, of normals
#pragma reads float stored                              // [B, CHANNELS, H, W] of the previous frame
#pragma reads float motion                              // [B, 2, H, W] in pixels
#pragma reads float depth, float normal                 // [B, 1, H, W], [B, 3, H, W]
#pragma reads float depth_before, float normal_before   // the same, of the previous frame
#pragma writes float result                             // [B, CHANNELS, H, W]
#pragma writes float valid                              // [B, 1, H, W]: 1 or 0

int b;

vec4 surface_before_at(ivec2 p) {
    int n = at(b, 0, p, 3, size), plane = size.x * size.y;
    return vec4(normal_before[n], normal_before[n + plane], normal_before[n + 2 * plane], depth_before[at(b, 0, p, 1, size)]);
}
#include "reproject.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    int n = at(b, 0, pixel, 3, size), plane = size.x * size.y;
    vec4 here = vec4(normal[n], normal[n + plane], normal[n + 2 * plane], depth[at(b, 0, pixel, 1, size)]);
    vec2 moved = vec2(motion[at(b, 0, pixel, 2, size)], motion[at(b, 1, pixel, 2, size)]);
    Taps taps = weigh_taps(pixel, moved, here, tolerance.x, tolerance.y);
    for (int c = 0; c < CHANNELS; ++c) {
        float sum = 0.0;
        for (int t = 0; t < 4; ++t) {
            if (taps.weight[t] > 0.0) sum += taps.weight[t] * stored[at(b, c, tap_pixel(taps, t), CHANNELS, size)];
        }
        result[at(b, c, pixel, CHANNELS, size)] = is_valid(taps) ? sum / taps.total : 0.0;
    }
    valid[at(b, 0, pixel, 1, size)] = is_valid(taps) ? 1.0 : 0.0;
}
