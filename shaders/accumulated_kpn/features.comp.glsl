#version 430
// What the network of accumulated_kpn sees: 18 channels, light compressed at one exposure, nearness and length in [0, 1].
// One invocation per pixel of the padded result, which repeats the border of the image.
//
// takes    light, surface, guide, past, running, mean_albedo [image_size] · statistics
// returns  result: activations [6, H, W]: noisy 3, running mean 3, previous output 3, albedo 3, its running mean 3, normal 3,
//          nearness 1, length 1, uncovered 1
// longest: frames after which the running mean forgets
#define PARAMETERS PARAMETER(ivec2, image_size) PARAMETER(float, longest)
#include "image.glsl"
#include "activations.glsl"
#include "network_input.glsl"
#include "past.glsl"

layout(std430, binding = 5) readonly restrict buffer Running { vec4 running[]; };
layout(std430, binding = 6) readonly restrict buffer MeanAlbedo { vec4 mean_albedo[]; };
layout(std430, binding = 7) writeonly restrict buffer Result { FOUR result[]; };

void main() {
    ivec2 padded = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(padded, size)) return;

    int i = at(min(padded, image_size - 1), image_size), o = at(padded, size), plane = size.x * size.y;
    vec3 noisy = compress(light[i].rgb), mean = compress(running[i].rgb), before = compress(past[i].rgb);
    vec3 albedo = guide[i].rgb, normal = surface[i].xyz;
    float uncovered = is_uncovered(past[i]) ? 1.0 : 0.0;
    result[o] = packed_four(vec4(noisy, mean.r));
    result[o + plane] = packed_four(vec4(mean.gb, before.rg));
    result[o + 2 * plane] = packed_four(vec4(before.b, albedo));
    result[o + 3 * plane] = packed_four(vec4(mean_albedo[i].rgb, normal.x));
    result[o + 4 * plane] = packed_four(vec4(normal.yz, nearness(surface[i].w), running[i].w / longest));
    result[o + 5 * plane] = packed_four(vec4(uncovered, 0.0, 0.0, 0.0));
}
