// Reprojected history: rgb, and in w what is known of it.
const int VALID = 1, UNCOVERED = 2;  // it shows this surface; a moving object has just uncovered the pixel

bool is_valid(vec4 past) { return (int(past.w) & VALID) != 0; }
bool is_uncovered(vec4 past) { return (int(past.w) & UNCOVERED) != 0; }
