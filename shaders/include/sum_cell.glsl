// Sums of differences over cells of RECALL_CELL² pixels, for `accumulated_kpn/stays`. A work group is a row of whole cells.
#pragma constants RECALL_CELL
#pragma writes vec4 cells  // [⌈H/RECALL_CELL⌉, ⌈W/RECALL_CELL⌉] Σ d, Σ |d|² and what is added

shared vec4 terms[GROUP_X * GROUP_Y];

// Sum up the term of each pixel, 0 beyond the picture. All invocations call it.
void sum_cell(ivec2 pixel, vec4 term) {
    ivec2 lane = ivec2(gl_LocalInvocationID.xy);
    terms[lane.y * GROUP_X + lane.x] = term;
    barrier();
    if (lane.x % RECALL_CELL != 0 || lane.y % RECALL_CELL != 0 || !inside(pixel, size)) return;
    vec4 sum = vec4(0.0);
    for (int y = 0; y < RECALL_CELL; ++y)
        for (int x = 0; x < RECALL_CELL; ++x) sum += terms[(lane.y + y) * GROUP_X + lane.x + x];
    cells[at(pixel / RECALL_CELL, (size + RECALL_CELL - 1) / RECALL_CELL)] = sum;
}
