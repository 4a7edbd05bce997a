// The reprojected previous output: rgb, and in w these flags.
const int ON_SCREEN = 1;  // the pixel's surface was on the screen
const int UNCOVERED = 2;  // a moving object has just uncovered the pixel

bool is_on_screen(vec4 past) { return (int(past.w) & ON_SCREEN) != 0; }
bool is_uncovered(vec4 past) { return (int(past.w) & UNCOVERED) != 0; }

// Whether motion leads to the pixel's own history.
bool has_history(vec4 past) { return is_on_screen(past) && !is_uncovered(past); }
