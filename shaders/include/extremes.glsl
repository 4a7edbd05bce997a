// The least and the greatest light of a work group, found by all its invocations together in low[0] and high[0].
shared vec3 low[GROUP_X * GROUP_Y], high[GROUP_X * GROUP_Y];

void reduce_extremes(int lane) {
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) {
            low[lane] = min(low[lane], low[lane + step]);
            high[lane] = max(high[lane], high[lane + step]);
        }
    }
}
