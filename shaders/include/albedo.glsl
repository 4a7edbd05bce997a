// The albedo of a pixel: rgb, and in w whether radiance is divided by it.
const float LEAST_ALBEDO = 0.05;

// What radiance is divided by to take textures out of it (color.albedo_divisor), and multiplied by in the end.
vec3 divisor(vec4 albedo) {
    return albedo.w != 0.0 ? max(albedo.rgb, LEAST_ALBEDO) : vec3(1.0);
}
