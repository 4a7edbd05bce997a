// Whether a pixel and its 8 neighbours hit nothing (ops.even_sky). Takes `vec4 surface`, normal and depth.
bool is_open(ivec2 pixel) {
    for (int k = 0; k < 9; ++k) {
        ivec2 p = pixel + ivec2(k % 3, k / 3) - 1;
        if (inside(p, size) && surface[at(p, size)].w > 0.0) return false;
    }
    return true;
}
