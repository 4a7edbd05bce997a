// D of eq. 4: mean or maximum over one cell of the tensor `fine` [B, CHANNELS, H, W], declared before this file is included.
#pragma constants POOL_MAX

float pool(int b, int c, ivec2 cell) {
    float total = 0.0, count = 0.0;
    float greatest = fine[at(b, c, 2 * cell, CHANNELS, size)];
    for (int i = 0; i < 4; ++i) {
        ivec2 p = 2 * cell + ivec2(i & 1, i >> 1);
        if (!inside(p, size)) continue;
        float value = fine[at(b, c, p, CHANNELS, size)];
        total += value;
        count += 1.0;
        greatest = max(greatest, value);
    }
    return POOL_MAX == 1 ? greatest : total / count;
}
