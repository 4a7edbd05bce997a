#version 430
// values[i] = value, for all i < count. Invocations form rows of ROW: a device may refuse more than 65535 groups a side.
#pragma constants GROUP_X ROW
#pragma parameters uint count, uint value
#pragma writes uint values

layout(local_size_x = GROUP_X) in;

void main() {
    uint i = gl_GlobalInvocationID.y * uint(ROW) + gl_GlobalInvocationID.x;
    if (i < count) values[i] = value;
}
