#version 430
// What the network of accumulated_kpn sees: 21 channels, light compressed at one exposure, nearness and length in [0, 1].
// One invocation per pixel of the padded result, which repeats the border of the image. The order is not that of torch: in
// the last two groups is what may be zero everywhere, and then is not written: GROUPS 5 where nothing has been uncovered,
// 4 in a first frame, which does not read `running`.
//
// takes    light, surface, guide, past, running, mean_albedo [image_size] · statistics
// returns  result: activations [6, H, W]: noisy 3, nearness 1 · previous output 3, normal x · albedo 3, normal y · its running
//          mean 3, normal z · running mean 3, length 1 · uncovered 1
// longest: frames after which the running mean forgets
#pragma constants GROUPS
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
    vec3 normal = surface[i].xyz;
    result[o] = packed_four(vec4(compress(light[i].rgb), nearness(surface[i].w)));
    result[o + plane] = packed_four(vec4(compress(past[i].rgb), normal.x));
    result[o + 2 * plane] = packed_four(vec4(guide[i].rgb, normal.y));
    result[o + 3 * plane] = packed_four(vec4(mean_albedo[i].rgb, normal.z));
    if (GROUPS > 4) result[o + 4 * plane] = packed_four(vec4(compress(running[i].rgb), running[i].w / longest));
    if (GROUPS > 5) result[o + 5 * plane] = packed_four(vec4(is_uncovered(past[i]) ? 1.0 : 0.0, 0.0, 0.0, 0.0));
}
