#version 430
// Reprojection that takes no tap from another surface or from off the screen, and says where no tap was left:
//
//     out(p) = Σ_t b_t v_t stored(t) / Σ_t b_t v_t          over the four pixels t around p + motion(p)
//
// with the bilinear weights b_t, and v_t = 1 where t is on the screen and shows a surface `alike` that at p. Where
// Σ b v < 0.01 the result is 0 and not valid.
//
// takes    stored [B, CHANNELS, H, W] of the previous frame · motion [B, 2, H, W] · depth [B, 1, H, W], normal [B, 3, H, W] ·
//          depth_before, normal_before of the previous frame
// returns  result [B, CHANNELS, H, W] · valid [B, 1, H, W]: 1 or 0
#pragma constants CHANNELS
#define PARAMETERS PARAMETER(vec2, tolerance)  // of depth, of normals
#include "tensor.glsl"
#include "finite.glsl"
#include "alike.glsl"

layout(std430, binding = 0) readonly restrict buffer Stored { float stored[]; };
layout(std430, binding = 1) readonly restrict buffer Motion { float motion[]; };
layout(std430, binding = 2) readonly restrict buffer Depth { float depth[]; };
layout(std430, binding = 3) readonly restrict buffer Normal { float normal[]; };
layout(std430, binding = 4) readonly restrict buffer DepthBefore { float depth_before[]; };
layout(std430, binding = 5) readonly restrict buffer NormalBefore { float normal_before[]; };
layout(std430, binding = 6) writeonly restrict buffer Result { float result[]; };
layout(std430, binding = 7) writeonly restrict buffer Valid { float valid[]; };

const float FAR_AWAY = 1e6;  // as good as off the screen, and its square pixel numbers still fit an integer
const float LEAST = 1e-2;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    int plane = size.x * size.y, here = at(b, 0, pixel, 3, size);
    vec2 moved = vec2(motion[at(b, 0, pixel, 2, size)], motion[at(b, 1, pixel, 2, size)]);
    moved = vec2(finite_or(moved.x, FAR_AWAY), finite_or(moved.y, FAR_AWAY));
    vec2 target = vec2(pixel) + clamp(moved, -FAR_AWAY, FAR_AWAY);
    ivec2 corner = ivec2(floor(target));
    vec2 f = target - vec2(corner);
    vec4 surface = vec4(normal[here], normal[here + plane], normal[here + 2 * plane], depth[at(b, 0, pixel, 1, size)]);

    float weight[4];
    float total = 0.0;
    for (int tap = 0; tap < 4; ++tap) {
        ivec2 p = corner + ivec2(tap & 1, tap >> 1);
        weight[tap] = 0.0;
        if (!inside(p, size)) continue;
        int n = at(b, 0, p, 3, size);
        vec4 before = vec4(normal_before[n], normal_before[n + plane], normal_before[n + 2 * plane], depth_before[at(b, 0, p, 1, size)]);
        if (!alike(surface, before, tolerance.x, tolerance.y)) continue;
        weight[tap] = ((tap & 1) == 1 ? f.x : 1.0 - f.x) * ((tap >> 1) == 1 ? f.y : 1.0 - f.y);
        total += weight[tap];
    }
    for (int c = 0; c < CHANNELS; ++c) {
        float found = 0.0;
        for (int tap = 0; tap < 4; ++tap) {
            ivec2 p = clamp(corner + ivec2(tap & 1, tap >> 1), ivec2(0), size - 1);
            if (weight[tap] > 0.0) found += weight[tap] * stored[at(b, c, p, CHANNELS, size)];
        }
        result[at(b, c, pixel, CHANNELS, size)] = total >= LEAST ? found / total : 0.0;
    }
    valid[at(b, 0, pixel, 1, size)] = total >= LEAST ? 1.0 : 0.0;
}
