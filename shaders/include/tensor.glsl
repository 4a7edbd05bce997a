// Tensors [B, C, H, W] in shader storage buffers, in plain C order; one invocation per pixel, gl_GlobalInvocationID = (x, y, b).
// The group size is the caller's choice: with 32 × 4 the 32 or 64 lanes that run together read whole rows.
#pragma constants GROUP_X GROUP_Y

layout(local_size_x = GROUP_X, local_size_y = GROUP_Y) in;

// size: (W, H) of the finer grid of the pass. A pass that is told more than that defines PARAMETERS before it includes this:
// uniforms in OpenGL, push constants in Vulkan.
#ifndef PARAMETERS
#define PARAMETERS
#endif
#ifdef VULKAN
#define PARAMETER(type, name) type name;
layout(push_constant) uniform Pass { ivec2 size; PARAMETERS };
#else
#define PARAMETER(type, name) uniform type name;
uniform ivec2 size;
PARAMETERS
#endif

// Index of tensor[b, c, p.y, p.x] where tensor is [B, channels, extent.y, extent.x].
int at(int b, int c, ivec2 p, int channels, ivec2 extent) {
    return ((b * channels + c) * extent.y + p.y) * extent.x + p.x;
}

bool inside(ivec2 p, ivec2 extent) {
    return all(greaterThanEqual(p, ivec2(0))) && all(lessThan(p, extent));
}
