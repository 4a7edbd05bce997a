// The last layer of the network, computed where its result is used: a kernel of 25 logits never reaches memory.
//
// CELL 1: a 1×1 convolution of features of this size. CELL 2: a 2×2 transposed convolution with stride 2 of features of
// half the size, which is a 1×1 convolution with other weights for each of the four pixels in a cell.
//
//     row[r, y, x] = bias[r] + Σ_i weight[⟨y mod CELL, x mod CELL⟩, r, i] · feature[i, ⌊y/CELL⌋, ⌊x/CELL⌋]
//
#pragma constants CELL ROWS
#pragma parameters ivec2 feature_size  // (W, H) of the features, padding included
#pragma parameters int groups          // of four features
#include "activations.glsl"

#pragma reads FOUR features  // [groups, feature_size]
#pragma reads mat4 weights   // [CELL², ⌈ROWS/4⌉, groups]: 4×4 blocks as in conv3x3
#pragma reads vec4 biases    // [⌈ROWS/4⌉]

const int FOURS = (ROWS + 3) / 4;

vec4 rows[FOURS];  // of this invocation's pixel

void predict(ivec2 pixel) {
    for (int r = 0; r < FOURS; ++r) rows[r] = biases[r];
    int first = CELL == 1 ? 0 : (2 * (pixel.y & 1) + (pixel.x & 1)) * FOURS * groups;
    for (int g = 0; g < groups; ++g) {
        vec4 feature = unpacked(features[in_group(g, pixel / CELL, feature_size)]);
        for (int r = 0; r < FOURS; ++r) rows[r] += weights[first + r * groups + g] * feature;
    }
}

float row(int r) {
    return rows[r >> 2][r & 3];
}

float sigmoid(float x) {
    return 1.0 / (1.0 + exp(-x));
}
