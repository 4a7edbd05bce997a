// Sums over cells of side × side pixels. A work group is a row of whole cells.
shared vec4 terms[GROUP_X * GROUP_Y];

// Whether this invocation has the first pixel of a cell, and the sum of the cell's terms, which are 0 beyond the picture. All
// invocations call it.
bool sum_cell(ivec2 pixel, int side, vec4 term, out vec4 sum) {
    ivec2 lane = ivec2(gl_LocalInvocationID.xy);
    terms[lane.y * GROUP_X + lane.x] = term;
    barrier();
    sum = vec4(0.0);
    if (lane.x % side != 0 || lane.y % side != 0 || !inside(pixel, size)) return false;
    for (int y = 0; y < side; ++y)
        for (int x = 0; x < side; ++x) sum += terms[(lane.y + y) * GROUP_X + lane.x + x];
    return true;
}
