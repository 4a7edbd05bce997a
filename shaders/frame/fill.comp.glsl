#version 430
// values[i] = value, for all i < count. Invocations are rows of ROW: a device need not take more than 65535 groups a side.
#pragma constants GROUP_X ROW
layout(local_size_x = GROUP_X) in;

layout(std430, binding = 0) writeonly restrict buffer Values { uint values[]; };

#ifdef VULKAN
layout(push_constant) uniform Pass { uint count; uint value; };
#else
uniform uint count;
uniform uint value;
#endif

void main() {
    uint i = gl_GlobalInvocationID.y * uint(ROW) + gl_GlobalInvocationID.x;
    if (i < count) values[i] = value;
}
