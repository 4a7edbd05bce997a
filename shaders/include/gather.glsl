// Filter a pixel with a softmax-normalised kernel of its own. The image is read once a work group, into shared memory.
//
//     w[k]  = softmax_k logits[k], over the taps k = dy·KERNEL + dx that lie inside the image
//     gathered(x, y) = Σ_{dy,dx} w[k] · image(x + dx - r, y + dy - r),    r = ⌊KERNEL/2⌋
//
// `vec3 source(ivec2 p)` is the image, `vec4 rows[]` holds the logits in its first KERNEL² components; both and
// #define ROWS come before this file is included.
#pragma constants KERNEL

const int REACH = KERNEL / 2;
const ivec2 TILE = ivec2(GROUP_X, GROUP_Y) + 2 * REACH;
const float LOWEST = -3.402823466e38;

shared vec4 tile[TILE.x * TILE.y];

// By all invocations of a work group together.
void load_tile() {
    ivec2 corner = ivec2(gl_WorkGroupID.xy) * ivec2(GROUP_X, GROUP_Y) - REACH;
    for (int i = int(gl_LocalInvocationIndex); i < TILE.x * TILE.y; i += GROUP_X * GROUP_Y) {
        ivec2 p = corner + ivec2(i % TILE.x, i / TILE.x);
        tile[i] = inside(p, size) ? vec4(source(p), 0.0) : vec4(0.0);
    }
    barrier();
}

vec3 gathered(ivec2 pixel, vec4 rows[FOURS]) {
    // The maximum is taken over the taps inside only: a tap outside must not push the others below what exp can hold.
    float greatest = LOWEST;
    for (int k = 0; k < KERNEL * KERNEL; ++k) {
        bool counts = inside(pixel + ivec2(k % KERNEL, k / KERNEL) - REACH, size);
        greatest = max(greatest, counts ? rows[k >> 2][k & 3] : LOWEST);
    }
    float total = 0.0;
    vec3 sum = vec3(0.0);
    for (int k = 0; k < KERNEL * KERNEL; ++k) {
        ivec2 tap = ivec2(k % KERNEL, k / KERNEL);
        float w = inside(pixel + tap - REACH, size) ? exp(rows[k >> 2][k & 3] - greatest) : 0.0;
        ivec2 local = ivec2(gl_LocalInvocationID.xy) + tap;
        total += w;
        sum += w * tile[local.y * TILE.x + local.x].rgb;
    }
    return sum / total;
}
