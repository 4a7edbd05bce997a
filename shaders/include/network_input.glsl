// The inputs that all networks share, and their encoding.
#pragma parameters ivec2 image_size  // (W, H) of the image; the parameter `size` includes padding
#pragma reads vec4 light, vec4 surface, vec4 guide, vec4 past  // [image_size]
#pragma reads float statistics                                 // [2]: exposure, mean distance

// log(1 + x) of the exposed radiance; by its series for small x, where 1 + x would round it away.
vec3 compress(vec3 radiance) {
    vec3 x = radiance * statistics[0];
    vec3 series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    return mix(log(1.0 + x), series, lessThan(x, vec3(0.02)));
}

// t / (t + depth) with t the frame's mean distance; 0 where nothing was hit.
float nearness(float depth) {
    return depth > 0.0 ? statistics[1] / (statistics[1] + depth) : 0.0;
}
