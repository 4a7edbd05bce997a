// The inputs that all networks share, and their encoding.
#include "curve.glsl"
#pragma parameters ivec2 image_size  // (W, H) of the image; the parameter `size` includes padding
#pragma reads vec4 light, vec4 surface, vec4 guide, vec4 past  // [image_size]
#pragma reads float statistics                                 // [2]: exposure, mean distance

vec3 compress(vec3 radiance) {
    return compressed(radiance * statistics[0]);
}

// t / (t + depth) with t the frame's mean distance; 0 where nothing was hit.
float nearness(float depth) {
    return depth > 0.0 ? statistics[1] / (statistics[1] + depth) : 0.0;
}
