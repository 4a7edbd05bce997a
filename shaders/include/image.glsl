// Images of the whole-frame passes: [H, W] of one vec4 a pixel; one invocation per pixel.
#include "tensor.glsl"

// Index of image[p.y, p.x].
int at(ivec2 p, ivec2 extent) {
    return p.y * extent.x + p.x;
}
