#pragma constants LUMINANCE_WEIGHTS

float luminance(vec3 rgb) {
    return dot(rgb, LUMINANCE_WEIGHTS);
}
