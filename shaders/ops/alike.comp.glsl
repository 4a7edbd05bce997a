#version 430
// Whether two pixels may show the same surface: include/alike.glsl.
#include "tensor.glsl"
#include "alike.glsl"

#pragma parameters vec2 tolerance                       // of depth, of normals
#pragma reads float depth, float normal                 // [B, 1, H, W], [B, 3, H, W]
#pragma reads float other_depth, float other_normal     // the same, of the surface to compare with
#pragma writes float result                             // [B, 1, H, W]: 1 or 0

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    int d = at(b, 0, pixel, 1, size), n = at(b, 0, pixel, 3, size), plane = size.x * size.y;
    vec4 surface = vec4(normal[n], normal[n + plane], normal[n + 2 * plane], depth[d]);
    vec4 other = vec4(other_normal[n], other_normal[n + plane], other_normal[n + 2 * plane], other_depth[d]);
    result[d] = alike(surface, other, tolerance.x, tolerance.y) ? 1.0 : 0.0;
}
