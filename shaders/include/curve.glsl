// log(1 + x) and its inverse (color.compress, color.expand) of x ≥ 0; by their series where x is small: 1 + x would round it away.
vec3 compressed(vec3 x) {
    vec3 series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    return mix(log(1.0 + x), series, lessThan(x, vec3(0.02)));
}

vec3 expanded(vec3 x) {
    vec3 series = x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0))));
    return mix(exp(x) - 1.0, series, lessThan(x, vec3(0.02)));
}
