// The last layer of the network, computed where its result is used: a kernel of 25 logits never reaches memory.
//
// CELL 1: a 1×1 convolution of the features of this size. CELL 2: a 2×2 transposed convolution with stride 2 of features of
// half the size, which is a 1×1 convolution with other weights for each of the four pixels in a cell.
//
//     row[r, y, x] = bias[r] + Σ_i weight[⟨y mod CELL, x mod CELL⟩, r, i] · feature[i, ⌊y/CELL⌋, ⌊x/CELL⌋]
//
// ROWS, the number of rows, is defined before this file is included; rows lie four by four, as channels of activations do.
// So are the parameters: feature_size, (W, H) of the features with what they are padded by; groups, of four features.
#pragma constants CELL
#include "activations.glsl"

layout(std430, binding = 0) readonly restrict buffer Features { FOUR features[]; };  // [groups, feature_size]
layout(std430, binding = 1) readonly restrict buffer Weights { mat4 weights[]; };  // [CELL², ⌈ROWS/4⌉, groups] as conv3x3
layout(std430, binding = 2) readonly restrict buffer Biases { vec4 biases[]; };  // [⌈ROWS/4⌉]

const int FOURS = (ROWS + 3) / 4;

void predict(ivec2 pixel, out vec4 rows[FOURS]) {
    for (int r = 0; r < FOURS; ++r) rows[r] = biases[r];
    int first = CELL == 1 ? 0 : (2 * (pixel.y & 1) + (pixel.x & 1)) * FOURS * groups;
    for (int g = 0; g < groups; ++g) {
        vec4 feature = unpacked(features[in_group(g, pixel / CELL, feature_size)]);
        for (int r = 0; r < FOURS; ++r) rows[r] += weights[first + r * groups + g] * feature;
    }
}

float sigmoid(float x) {
    return 1.0 / (1.0 + exp(-x));
}
