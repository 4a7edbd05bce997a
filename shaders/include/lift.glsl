// The curve on which networks that write pixels see light, and its inverse (ops.lift): log(1 + lifted(y)) is OIDN's, in its unit,
// of light with some grey in it: lifted(greyed(light)), coloured(lowered(x)).
#pragma constants PU_A PU_B PU_C PU_D PU_E PU_F PU_G PU_Y0 PU_Y1 PU_X0 PU_X1
#include "curve.glsl"
#include "grey.glsl"

vec3 lifted(vec3 light) {
    float slope = exp(PU_G / PU_E);
    vec3 power = (PU_B * pow(clamp(light, PU_Y0, PU_Y1), vec3(PU_C)) + PU_D) / PU_E;
    vec3 dark = expanded(mix(power, light * (PU_A / PU_E), lessThanEqual(light, vec3(PU_Y0))));
    return mix(slope * light + (slope * PU_F - 1.0), dark, lessThanEqual(light, vec3(PU_Y1)));
}

vec3 lowered(vec3 x) {
    float slope = exp(PU_G / PU_E);
    vec3 value = PU_E * compressed(x);
    vec3 power = pow((clamp(value, PU_X0, PU_X1) - PU_D) / PU_B, vec3(1.0 / PU_C));
    vec3 dark = mix(power, value / PU_A, lessThanEqual(value, vec3(PU_X0)));
    return mix(x / slope + (1.0 / slope - PU_F), dark, lessThanEqual(value, vec3(PU_X1)));
}
