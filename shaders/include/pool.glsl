// D of eq. 4: mean (POOL_MAX: maximum) over one cell.
//
// TYPE and `TYPE fine_value(ivec2 pixel)` are defined before this file is included.
#pragma constants POOL_MAX
#include "pyramid.glsl"

TYPE pool(ivec2 cell) {
    TYPE total = TYPE(0.0), greatest = fine_value(2 * cell);
    float count = 0.0;
    for (int i = 0; i < 4; ++i) {
        ivec2 p = 2 * cell + ivec2(i & 1, i >> 1);
        if (!inside(p, size)) continue;
        TYPE value = fine_value(p);
        total += value;
        count += 1.0;
        greatest = max(greatest, value);
    }
    return POOL_MAX == 1 ? greatest : total / count;
}
