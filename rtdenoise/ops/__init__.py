"""Operations on images and their kernels, with gradients.

An op has one name in four places: `ops/NAME.py` holds its index equation and the plain torch code that specifies it,
`ops/native/NAME.py` and `.c` its fused twin for the CPU, `ops/triton/NAME.py` for CUDA, `shaders/ops/NAME.comp.glsl`
for OpenGL, which `glsl/ops.py` calls. `dispatch` chooses between plain and fused. Only the public ops are exported
here; the files without a shader (`features`, `pixels`, `shares`, ...) serve the models and the preparation of frames.
`attend_channels` is plain torch alone: its work is matrix products, which torch has fast.

Image conventions are those of `rtdenoise.frame`: `[B, C, H, W]`, row 0 on top, x right, y down.
"""

from .alike import alike
from .apply_kernel import apply_kernel
from .attend_blocks import attend_blocks
from .attend_channels import attend_channels
from .blend import blend
from .compose import compose
from .dispatch import use
from .downsample import downsample
from .fetch import fetch
from .pick import pick
from .reproject import reproject
from .soften import soften
from .upsample import upsample
from .warp import warp

__all__ = [
    "alike", "apply_kernel", "attend_blocks", "attend_channels", "blend", "compose", "downsample", "fetch", "pick",
    "reproject", "soften", "upsample", "use", "warp",
]  # fmt: skip
