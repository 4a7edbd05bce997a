#version 430
// Replace the low frequencies of the finer scale by the coarser one, as far as its α says (eq. 4):
//
//     out = fine + U[α · (coarse - D fine)]
//
// takes    fine [H, W] rgb, its own α · coarse [⌈H/2⌉, ⌈W/2⌉] rgb, α
// returns  composed [H, W] rgb, α of `fine`
#include "image.glsl"

layout(std430, binding = 0) readonly restrict buffer Fine { vec4 fine[]; };
layout(std430, binding = 1) readonly restrict buffer Coarse { vec4 coarse[]; };
layout(std430, binding = 2) writeonly restrict buffer Composed { vec4 composed[]; };
#include "image_pool.glsl"

vec3 difference(int x, int y) {
    vec4 c = coarse[at(ivec2(x, y), coarse_size())];
    return c.a * (c.rgb - pool(ivec2(x, y)).rgb);
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    Cells q = cells_of(pixel);
    vec3 near = 0.75 * difference(q.near.x, q.near.y) + 0.25 * difference(q.far.x, q.near.y);
    vec3 far = 0.75 * difference(q.near.x, q.far.y) + 0.25 * difference(q.far.x, q.far.y);
    vec4 f = fine[at(pixel, size)];
    composed[at(pixel, size)] = vec4(f.rgb + 0.75 * near + 0.25 * far, f.a);
}
