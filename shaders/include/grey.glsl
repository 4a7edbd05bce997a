// Less pure colours for networks that write pixels, and the way back (ops.lift).
#pragma constants PIXELS_GREY

vec3 greyed(vec3 light) {
    return mix(light, vec3((light.r + light.g + light.b) / 3.0), PIXELS_GREY);
}

vec3 coloured(vec3 grey) {
    return max((grey - PIXELS_GREY * (grey.r + grey.g + grey.b) / 3.0) / (1.0 - PIXELS_GREY), 0.0);
}
