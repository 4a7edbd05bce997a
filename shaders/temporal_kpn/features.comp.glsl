#version 430
// The input of the network of temporal_kpn: 13 channels, light compressed at one exposure, depth as nearness in [0, 1). One
// invocation per pixel of the padded result, which repeats the border of the image.
#include "image.glsl"
#include "activations.glsl"
#include "network_input.glsl"

#pragma writes FOUR result  // [4, H, W]: noisy 3, albedo 3, normal 3, nearness 1, previous output 3

void main() {
    ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(padded, size)) return;

    int i = at(min(padded, image_size - 1), image_size), o = at(padded, size), plane = size.x * size.y;
    vec3 noisy = compress(light[i].rgb), before = compress(past[i].rgb);
    vec3 albedo = guide[i].rgb, normal = surface[i].xyz;
    result[o] = packed_four(vec4(noisy, albedo.r));
    result[o + plane] = packed_four(vec4(albedo.gb, normal.xy));
    result[o + 2 * plane] = packed_four(vec4(normal.z, nearness(surface[i].w), before.rg));
    result[o + 3 * plane] = packed_four(vec4(before.b, 0.0, 0.0, 0.0));
}
