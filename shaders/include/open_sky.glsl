// Whether a pixel and its 8 neighbours hit nothing, or the 4 at its sides (ops.even_sky). Take `vec4 surface`, normal and depth.
bool is_open(ivec2 pixel) {
    for (int k = 0; k < 9; ++k) {
        ivec2 p = pixel + ivec2(k % 3, k / 3) - 1;
        if (inside(p, size) && surface[at(p, size)].w > 0.0) return false;
    }
    return true;
}

bool shows_sky(ivec2 pixel) {
    const ivec2 sides[5] = ivec2[](ivec2(0, 0), ivec2(-1, 0), ivec2(1, 0), ivec2(0, -1), ivec2(0, 1));
    for (int k = 0; k < 5; ++k) {
        ivec2 p = pixel + sides[k];
        if (inside(p, size) && surface[at(p, size)].w > 0.0) return false;
    }
    return true;
}
