// The sRGB transfer curve and its inverse (color.srgb_encode, color.srgb_decode), of x ≥ 0.
vec3 srgb_encoded(vec3 linear) {
    vec3 curve = 1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
    return mix(curve, 12.92 * linear, lessThanEqual(linear, vec3(0.0031308)));
}

vec3 srgb_decoded(vec3 encoded) {
    vec3 curve = pow((max(encoded, 0.04045) + 0.055) / 1.055, vec3(2.4));
    return mix(curve, encoded / 12.92, lessThanEqual(encoded, vec3(0.04045)));
}
