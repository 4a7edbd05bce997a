// Whether a target of motion lies on the image: pixel (0, 0) is at (0, 0), its edges at ±½.
bool on_screen(vec2 target) {
    return all(greaterThanEqual(target, vec2(-0.5))) && all(lessThanEqual(target, vec2(size) - 0.5));
}

ivec2 nearest(vec2 target) {
    return ivec2(floor(clamp(target, vec2(0.0), vec2(size - 1)) + 0.5));
}
