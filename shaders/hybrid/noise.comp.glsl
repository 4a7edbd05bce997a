#version 430
// The noise of each window of NOISE_WINDOW² pixels, one every NOISE_WINDOWS pixels, for `level`.
#pragma constants NOISE_WINDOW NOISE_WINDOWS
#pragma parameters ivec2 image_size
#include "image.glsl"
#include "albedo.glsl"

#pragma reads vec4 light, vec4 guide, vec4 surface  // [image_size]
#pragma writes float relative                       // [size] variance over squared mean; -1 where something was not hit, or black

void main() {
    ivec2 window = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(window, size)) return;

    float sum = 0.0, squares = 0.0;
    bool hit = true;
    const int count = NOISE_WINDOW * NOISE_WINDOW;
    for (int k = 0; k < count; ++k) {
        int i = at(window * NOISE_WINDOWS + ivec2(k % NOISE_WINDOW, k / NOISE_WINDOW), image_size);
        vec3 rgb = light[i].rgb * divisor(guide[i]);
        float mean = (rgb.r + rgb.g + rgb.b) / 3.0;
        sum += mean;
        squares += mean * mean;
        hit = hit && surface[i].w > 0.0;
    }
    float mean = sum / float(count), square = squares / float(count);
    float variance = max(square / max(mean * mean, 1e-30) - 1.0, 0.0) * float(count) / float(count - 1);
    relative[at(window, size)] = hit && mean > 0.0 ? variance : -1.0;
}
