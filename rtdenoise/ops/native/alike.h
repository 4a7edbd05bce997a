// Whether two pixels may show the same surface. The specification is ops/alike.py.

typedef struct { float depth, x, y, z, square; } Surface;  // depth and normal of a pixel, and the square of its length

static inline float squared(float x, float y, float z) { return x * x + y * y + z * z; }

static inline Surface surface(float depth, float x, float y, float z) { return (Surface){depth, x, y, z, squared(x, y, z)}; }

static inline Surface surface_at(const float *depth, const float *normal, int64_t plane, int at) {
    return surface(depth[at], normal[at], normal[plane + at], normal[2 * plane + at]);
}

static inline float signed_square(float x) { return x * fabsf(x); }  // keeps order, so that no root need be taken

static inline int alike(Surface a, Surface b, float depth_tolerance, float normal_tolerance) {
    float along = a.x * b.x + a.y * b.y + a.z * b.z;
    int near = fabsf(a.depth - b.depth) <= depth_tolerance * MAX(a.depth, b.depth);
    int aligned = signed_square(along) >= signed_square(normal_tolerance) * (a.square * b.square);
    int hit = a.depth > 0, other_hit = b.depth > 0;
    return (hit & other_hit & near & aligned) | (!hit & !other_hit);
}
