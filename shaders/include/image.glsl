// Images of the whole-frame passes: [H, W] with one vec4 per pixel; one invocation per pixel.
#include "tensor.glsl"

// Index of image[p.y, p.x].
int at(ivec2 p, ivec2 extent) {
    return p.y * extent.x + p.x;
}
