// A frame as a network sees it. The parameter image_size is (W, H) of the image, which `size` is padded from.
layout(std430, binding = 0) readonly restrict buffer Light { vec4 light[]; };
layout(std430, binding = 1) readonly restrict buffer Surface { vec4 surface[]; };
layout(std430, binding = 2) readonly restrict buffer Guide { vec4 guide[]; };
layout(std430, binding = 3) readonly restrict buffer Past { vec4 past[]; };
layout(std430, binding = 4) readonly restrict buffer Statistics { float statistics[]; };  // exposure, distance

// log(1 + x) of the exposed radiance; for small x by its series, where 1 + x would lose it.
vec3 compress(vec3 radiance) {
    vec3 x = radiance * statistics[0];
    vec3 series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    return mix(log(1.0 + x), series, lessThan(x, vec3(0.02)));
}

// t / (t + depth) with t the frame's mean distance; 0 where nothing was hit.
float nearness(float depth) {
    return depth > 0.0 ? statistics[1] / (statistics[1] + depth) : 0.0;
}
