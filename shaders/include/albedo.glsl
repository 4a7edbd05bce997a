// The albedo of a pixel: rgb, and in w whether radiance is divided by it.
const float LEAST_ALBEDO = 0.1, ALBEDO_SHARE = 0.25;

// What radiance is divided by to take textures out of it (color.albedo_divisor), and multiplied by in the end.
vec3 divisor(vec4 albedo) {
    float brightest = max(albedo.r, max(albedo.g, albedo.b));
    return albedo.w != 0.0 ? max(albedo.rgb, max(LEAST_ALBEDO, ALBEDO_SHARE * brightest)) : vec3(1.0);
}
