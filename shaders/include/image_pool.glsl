// D of eq. 4 on the image `fine` [H, W], declared before this file is included: mean (POOL_MAX: maximum) over one cell.
#pragma constants POOL_MAX
#include "pyramid.glsl"

vec4 pool(ivec2 cell) {
    vec4 total = vec4(0.0), greatest = fine[at(2 * cell, size)];
    float count = 0.0;
    for (int i = 0; i < 4; ++i) {
        ivec2 p = 2 * cell + ivec2(i & 1, i >> 1);
        if (!inside(p, size)) continue;
        vec4 value = fine[at(p, size)];
        total += value;
        count += 1.0;
        greatest = max(greatest, value);
    }
    return POOL_MAX == 1 ? greatest : total / count;
}
