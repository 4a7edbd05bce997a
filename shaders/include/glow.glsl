// Surfaces that shine by themselves (ops.glow): GLOW(name, albedo) defines name(pixel), which tells whether one is within
// GLOW_REACH pixels, by the buffer `albedo` [H, W].
#pragma constants GLOWS GLOW_REACH

#define GLOW(name, albedo)                                                                                             \
    bool name(ivec2 pixel) {                                                                                           \
        for (int y = max(0, pixel.y - GLOW_REACH); y <= min(size.y - 1, pixel.y + GLOW_REACH); y++)                    \
            for (int x = max(0, pixel.x - GLOW_REACH); x <= min(size.x - 1, pixel.x + GLOW_REACH); x++)                \
                if (any(greaterThan(albedo[y * size.x + x].rgb, vec3(GLOWS)))) return true;                            \
        return false;                                                                                                  \
    }
