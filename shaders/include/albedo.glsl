// The divisor that takes textures out of radiance (color.albedo_divisor), and the factor that gives them back.
// `albedo.w` says whether this pixel is divided at all.
#pragma constants GLOSS

vec3 divisor(vec4 albedo) { return albedo.w != 0.0 ? albedo.rgb + GLOSS : vec3(1.0); }
