"""Constants that torch, the fused operations and the shaders share. Without torch."""

LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)  # of red, green and blue, Rec. 709

# Added to the albedo where radiance is divided by it: the part of the light that does not take the surface's colour
# (`color.albedo_divisor`).
GLOSS = 0.08

# Two pixels may show the same surface (`ops.alike`).
DEPTH_TOLERANCE = 0.1  # largest difference of depths, as a share of the greater one
MIN_NORMAL_COSINE = 0.5
# Sum of bilinear weights below which there is no history: dividing by it would only magnify rounding (`ops.reproject`).
MIN_HISTORY_WEIGHT = 1e-2
FAR_AWAY = 1e6  # pixels: longer motion is off the screen anyway, and this still fits an integer

# Recent frames whose light is looked up anew (`ops.recall`).
RECALL_FRAMES = 8  # kept where footprints or frames ahead ask for any, whatever the configuration says
RECALL_FRAMES_OF_PASS = 12  # likewise by each pass of the offline mode, of few samples a pixel
RECALL_BOTH_SIDES = 12  # looked up where there are frames ahead, too: those nearest in time (docs/notes/lookahead.md)
RECALL_WORDS = 5  # channels of a kept frame, two bfloat16 in each
RECALL_FOOTPRINT_WORDS = 8  # of one that keeps albedo and the motion of edges, too
RECALL_EDGE_SPEED = 1.0  # pixels a frame against what is behind it, up to which an edge is followed
RECALL_RESET = 3  # of these the one whose higher half is the reset
RECALL_DEPTH = 1  # likewise the depth
RECALL_CELL = 4  # side in pixels of the cells in which light is compared; 3 × 3 cells count together
RECALL_ALIKE, RECALL_CHANGED = 2.0, 4.0  # |sum of differences|² / sum of |differences|²: light counts whole; not at all
RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED = 6.0, 12.0  # likewise over cells of twice the side
RECALL_WHITE, RECALL_JOINED = 0.15, 0.3  # likewise correlation of differences in neighbouring pixels
RECALL_ROUNDING = 4e-4  # share of this frame's light that squared differences have at least: bfloat16 rounds light
RECALL_SAME = 2.0**-7  # values that differ by this share are the same: kept frames are bfloat16
RECALL_NOISY = 0.25  # noise (`exposure.noise_level`) from which on lookups off the pixel count as far as they cover it
RECALL_MISPLACED = 2.0  # below that the square of their distance counts so many times 1 / noise - 1 / RECALL_NOISY, too
RECALL_MISPLACED_MORE = 0.2  # likewise with `Frame.more_history`
RESET_MORE = 0.5  # share of the network's reset that counts for footprints of many samples, likewise

# Light of earlier frames that is as bright as now (`ops.relit`).
RELIT_CELL = 4  # side in pixels of the cells that are multiplied
RELIT_SIDES = 4, 2  # side in cells of the squares in which light is compared, one after the other; 3 × 3 count together
RELIT_FROM, RELIT_WHOLE = 4.0, 8.0  # |sum of differences|² / sum of |differences|²: light begins to follow; does wholly
RELIT_ROUNDING = 4e-3  # share of the sum of earlier light that sums differ by at least: kept frames are bfloat16
RELIT_DARKER = 1.5  # these bounds for light that becomes darker, so many times as high: the rarest samples are bright
RELIT_MOST = 4.0  # times as bright, or as dark, in each comparison

# Surfaces that are hit here and there, as they are out of focus (`ops.scattered`).
SCATTERED_ALIKE = 1  # of the eight pixels around a lone sample, so many at most show its surface, as lone as it
SCATTERED_REACH = 3  # pixels along either axis around a lone sample, in which its surface may be seen
SCATTERED_APART = 1.6  # times the nearest of these: where the farthest is more, what lies between passes unnoticed

# Lone bright pixels (`ops.fireflies`).
FIREFLY_ALIKE = 5  # of the eight pixels around a firefly, so many at least show its surface

# Edges that move against what is behind them (`ops.over`).
OVER_APART = 0.05  # least difference of distances, as a share of the greater one
OVER_SPEED = 0.5  # least motion against what is behind, in pixels a frame
OVER_LIGHT = 0.5  # share of radiance that is what frames saw of both; the rest is the footprint of one

# Surfaces that turn (`ops.turned`).
TURNED_CELL = 4  # side in pixels of the cells over which normals are compared; 3 × 3 cells count together
TURNED_NOISE = 8.0  # |sum of differences|² / sum of |differences|², 1 on average for noise, from which a surface turns
TURNED_ANGLE = 0.09  # radians (5°) by which history falls to 1 / e

# Textures that move over their surfaces (`ops.retextured`), in the same cells.
RETEXTURED_LEAST, RETEXTURED_MOST = 0.05, 0.1  # albedo, beyond all around it: history begins to give way; is gone
MOVED_LEAST, MOVED_MOST = 0.01, 0.1  # likewise its squared distance from albedo before, more than from neighbours

# Light that has changed since all frames before (`ops.outdated`).
AGREES_PATIENCE = 1.5  # the bounds of `recall` for a running mean, so many times as high: one test tells of all frames
OUTDATED_CELL = 8  # side in pixels of the cells in which nothing may agree
OUTDATED_RIM, OUTDATED_FRAMES = 4, 3  # likewise beside others, where so many frames must agree
OUTDATED_PICTURE = 0.9  # share from which on the previous picture is as if off the screen

# Whether a frame belongs to another shot (`history.mismatch`).
CUT_ALIKE = 1.0  # pixels by which neighbours' motion may differ, if they move as one
CUT_AROUND = 3.0  # a mismatch is so many times the share of pixels whose surface is nowhere around, at most
CUT_UNMOVED = 5.0  # so many times it where the motion of all pixels is zero, though they do not stand still
MOVES = 0.05  # a mismatch from which on they do not

# A camera that goes ahead (`history.advance`).
ADVANCE_LEAST, ADVANCE_MOST = 0.01, 1 / 3  # of the way to what is seen, in a frame
ADVANCE_GAIN = 0.02  # of the pixels with history: as many more must find their surface

MAX_CRACK_DISTANCE = 2  # pixels across which the splat closes cracks (`splat.splat_motion_next`)

# Light that moves otherwise than its surfaces (`shift`).
SHIFT_CELL = 16  # side in pixels of the cells of a picture that move as one (`shift.picture`)
SHIFT_LIGHT_CELL = 32  # likewise, of light without noise (`shift.light`)
SHIFT_STRIDE, SHIFT_ROUNDS = 2, 2  # every so many pixels along either axis are looked at; rounds of least squares
SHIFT_DAMPING, SHIFT_LIGHT_DAMPING = 0.003, 0.03  # added to the mean of squared slopes
SHIFT_AROUND = 3  # cells: so many by so many are fitted together
SHIFT_BRIGHTNESS = 8.0  # light of a picture's mean becomes log(1 + SHIFT_BRIGHTNESS)
SHIFT_LEAST, SHIFT_GREATEST = 0.2, 1.2  # pixels: shorter shifts are noise, longer ones mistakes
SHIFT_BLOCK = 3  # side in pixels of the blocks that are even or not
SHIFT_EVEN = 4e-3  # an even block's greatest luminance over its mean, less 1; half floats round by an eighth of that
SHIFT_CONTRAST = 1.5  # greatest luminance around an even block over the least one, from which there is an edge
SHIFT_BESIDE = 3  # blocks from an even one, up to which its surface shifts with it
SHIFT_LEFT, SHIFT_SURE = 0.7, 0.5  # shares of the pictures' squared difference that a shift may leave, and may alone
SHIFT_APART = 0.8  # of a shift's length: how far it may be from that of the frame before

# The brightness of a frame, and pixels that are too bright for it (`exposure`).
BRIGHTNESS_BLOCK = 8  # side in pixels of the blocks over which brightness is measured
BRIGHTNESS_TENTHS = 9  # of the blocks: so many count, the darkest ones; of the black ones no more than there are others
NOISE_WINDOW, NOISE_WINDOWS = 3, 8  # side in pixels of the windows in which noise is measured, and from one to the next
MIN_BRIGHTNESS = 1e-8  # darker frames count as black
FIREFLY_LIMIT = 5.0  # times the brightest neighbour or the usual brightness in the frame

# A sky without noise (`ops.even_sky`).
SKY_BLOCK = 8  # side in pixels of the blocks that are compared
SKY_TOLERANCE = 1e-3  # largest relative difference in an even sky; half floats round by half of that

# What a noisy frame tells of two pictures (`ops.mix`).
MIX_CELL = 4  # side in pixels of the cells of its sums
MIX_DARK = 0.05  # exposed light: differences of darker light count less than in proportion
MIX_LARGEST = 1e6  # of relative differences: their squares stay finite
MIX_NOISE = 1e-6  # of their squares, that is there at least: pictures without noise that are alike tell nothing

# The shares of the kernels' picture and of the previous one, and the least of the kernels' where the noisy frame tells
# of other pixels. For many samples a pixel: a lookup of the previous picture costs more than it takes noise away, and
# kernels may be worse than written pixels everywhere.
MIX_SHARES, MIX_SHARES_OF_MANY = (0.4, 0.2, 0.4), (0.3, 0.0, 0.0)
MIX_SHARES_OF_CLEAN = (0.3, 0.2, 0.3)  # beside pixels of albedo and normal without noise
MIX_FAR = 0.1  # compressed light: a previous picture that differs by more counts as if it differed by this
MIX_UNCOVERED = 0.2  # likewise the kernels' picture, in pixels that were just uncovered: it spreads what shone beside
MIX_TELLS = 0.5  # in those the noisy frame tells less than so far of the pixel itself
MIX_WORD_FROM, MIX_WORD_WHOLE = 2.0, 4.0  # noise (`exposure.noise_level`) from which on few samples tell, and wholly
MIX_SEEN_ONCE = 0.6  # share of the noisy light where one frame has seen a pixel, and others have a history
EVENED_NOISE = 0.3  # noise (`exposure.noise_level`) from which on that is its share; without noise it is 1
GLOWS, GLOW_REACH = 1.0, 2  # albedo above which a surface shines by itself; pixels around it whose light stays, too

# A picture and the one after it (`ops.settle`): how much of their difference over 3 × 3 pixels the first takes, and how
# much of what is finer, where it has a history and where it has none.
SETTLE_BROAD, SETTLE_FINE = 0.3, 0.1
SETTLE_BROAD_NEW, SETTLE_FINE_NEW = 0.5, 0.4
SETTLE_FAR = 0.1  # compressed light: greater differences count as this

# The input of a network that writes pixels (`models.hybrid`).
PIXELS_LIGHT = 0.4  # what light of a frame's brightness becomes (OIDN's auto-exposure: about a third)
PIXELS_GREY = 0.06  # share of its mean over colours that light gets: these networks know no pure colours
PIXELS_UNIT = 0.06145  # of compressed light, as OIDN has it
# OIDN's curve for light y (`ops.lift`), PU(y): A y up to Y0, B yᶜ + D up to Y1, E log(y + F) + G beyond.
PU_A, PU_B, PU_C, PU_D = 1412.83765, 1.64593172, 0.431384981, -0.00294139609
PU_E, PU_F, PU_G = 0.192653254, 0.00626026094, 0.998620152
PU_Y0, PU_Y1 = 1.57945760e-6, 0.0322087631
PU_X0, PU_X1 = 0.00223151711, 0.370974749  # the curve's values there

AROUND_CELL = 16  # side in pixels of the cells in which what is around a pixel lies (`ops.around`)

MIN_DISTANCE = 1e-12  # least mean depth of a frame: never zero (`ops.mean_distance`)

MAX_HALF = 65504.0  # the largest half float

SOFTWARE_RENDERER = "llvmpipe"  # in the name of Mesa's renderer for machines without a GPU
