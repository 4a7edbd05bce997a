#version 430
// Whether two pixels may show the same surface: include/alike.glsl.
//
// takes    depth [B, 1, H, W], normal [B, 3, H, W] · other_depth, other_normal of what it is compared with
// returns  result [B, 1, H, W]: 1 or 0
#define PARAMETERS PARAMETER(vec2, tolerance)  // of depth, of normals
#include "tensor.glsl"
#include "alike.glsl"

layout(std430, binding = 0) readonly restrict buffer Depth { float depth[]; };
layout(std430, binding = 1) readonly restrict buffer Normal { float normal[]; };
layout(std430, binding = 2) readonly restrict buffer OtherDepth { float other_depth[]; };
layout(std430, binding = 3) readonly restrict buffer OtherNormal { float other_normal[]; };
layout(std430, binding = 4) writeonly restrict buffer Result { float result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    int d = at(b, 0, pixel, 1, size), n = at(b, 0, pixel, 3, size), plane = size.x * size.y;
    vec4 surface = vec4(normal[n], normal[n + plane], normal[n + 2 * plane], depth[d]);
    vec4 other = vec4(other_normal[n], other_normal[n + plane], other_normal[n + 2 * plane], other_depth[d]);
    result[d] = alike(surface, other, tolerance.x, tolerance.y) ? 1.0 : 0.0;
}
