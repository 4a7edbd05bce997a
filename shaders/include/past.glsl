// The reprojected previous output: rgb, and in w what is known of it.
const int ON_SCREEN = 1, UNCOVERED = 2;  // there is one; a moving object has just uncovered the pixel

bool is_on_screen(vec4 past) { return (int(past.w) & ON_SCREEN) != 0; }
bool is_uncovered(vec4 past) { return (int(past.w) & UNCOVERED) != 0; }
