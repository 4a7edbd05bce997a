// The divisor that takes textures out of radiance (color.albedo_divisor), and the factor that gives them back.
// `albedo.w` says whether this pixel is divided at all.
#pragma constants MIN_ALBEDO MIN_ALBEDO_SHARE

vec3 divisor(vec4 albedo) {
    float brightest = max(albedo.r, max(albedo.g, albedo.b));
    return albedo.w != 0.0 ? max(albedo.rgb, max(MIN_ALBEDO, MIN_ALBEDO_SHARE * brightest)) : vec3(1.0);
}
