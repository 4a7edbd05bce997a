// Tensors [B, C, H, W] in storage buffers, in C order; one invocation per pixel, gl_GlobalInvocationID = (x, y, b).
// The caller chooses the group size: with 32 × 4 the 32 or 64 lanes that run together read whole rows.
#pragma constants GROUP_X GROUP_Y
#pragma parameters ivec2 size  // (W, H) of the finest grid of the pass

layout(local_size_x = GROUP_X, local_size_y = GROUP_Y) in;

// Index of tensor[b, c, p.y, p.x] where the tensor is [B, channels, extent.y, extent.x].
int at(int b, int c, ivec2 p, int channels, ivec2 extent) {
    return ((b * channels + c) * extent.y + p.y) * extent.x + p.x;
}

bool inside(ivec2 p, ivec2 extent) {
    return all(greaterThanEqual(p, ivec2(0))) && all(lessThan(p, extent));
}
