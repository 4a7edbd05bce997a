// Filter an image with a softmax-normalised kernel per pixel. A work group reads the image once, into shared memory.
//
//     gathered(x, y) = Σ_{dy,dx} w[k] · image(x + dx - r, y + dy - r),    w = softmax over k = dy·KERNEL + dx, r = ⌊KERNEL/2⌋
//
// `float logit(int k)` and `vec3 source(ivec2 p)`, the image, are defined before this file is included.
#include "softmax.glsl"

const int RADIUS = KERNEL / 2;
const ivec2 TILE = ivec2(GROUP_X, GROUP_Y) + 2 * RADIUS;

shared vec4 tile[TILE.x * TILE.y];

// Called by all invocations of a work group together.
void load_tile() {
    ivec2 corner = ivec2(gl_WorkGroupID.xy) * ivec2(GROUP_X, GROUP_Y) - RADIUS;
    for (int i = int(gl_LocalInvocationIndex); i < TILE.x * TILE.y; i += GROUP_X * GROUP_Y) {
        ivec2 p = corner + ivec2(i % TILE.x, i / TILE.x);
        tile[i] = inside(p, size) ? vec4(source(p), 0.0) : vec4(0.0);
    }
    barrier();
}

vec3 gathered(ivec2 pixel) {
    float total = softmax(pixel - RADIUS, size);
    vec3 sum = vec3(0.0);
    for (int k = 0; k < TAPS; ++k) {
        ivec2 local = ivec2(gl_LocalInvocationID.xy) + tap(k);
        sum += weight[k] * tile[local.y * TILE.x + local.x].rgb;
    }
    return sum / total;
}
