#version 430
// Surfaces as from a camera that has gone ahead by so much (ops.kept.nearer).
#include "image.glsl"
#include "nearer.glsl"

#pragma reads vec4 surface   // [H, W] normal, depth
#pragma writes vec4 shifted  // [H, W] likewise

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;
    int i = at(pixel, size);
    shifted[i] = vec4(surface[i].xyz, nearer(surface[i].w));
}
