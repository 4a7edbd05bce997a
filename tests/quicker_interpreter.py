"""Triton's interpreter without what it does again and again: tests in it take two thirds of the time."""

import functools

from triton import language as tl
from triton.runtime import interpreter


def install():
    """Patch the language once a launch, not once for every call of a function in a kernel; make a type of blocks once;
    look a dtype of numpy up instead of writing the table of all anew. A Triton with other names inside stays as it
    is."""
    names = ("_get_np_dtype", "_patch_lang", "GridExecutor")
    if any(not hasattr(interpreter, name) for name in names) or getattr(interpreter, "quicker", False):
        return
    interpreter.quicker = True
    np_dtype, patch_lang, launch = (getattr(interpreter, name) for name in names)
    of_scalar, patched, execute = functools.cache(np_dtype), set(), launch.__call__

    def np_dtype_of(dtype):  # of a block: that of its elements
        return np_dtype(dtype) if isinstance(dtype.scalar, tl.pointer_type) else of_scalar(dtype.scalar)

    def patch_once(function):
        seen = {id(value) for value in function.__globals__.values() if value is tl or value is tl.core}
        if seen <= patched:
            return None  # only the launch itself undoes what it patched
        patched.update(seen)
        return patch_lang(function)

    def execute_patched(self, *arguments, **named):
        patched.clear()
        try:
            return execute(self, *arguments, **named)
        finally:
            patched.clear()

    types, new_type = {}, tl.block_type.__init__

    def block_type(self, element_ty, shape):
        if type(element_ty) is not tl.dtype:  # a pointer
            return new_type(self, element_ty, shape)
        key = element_ty.name, *(n.value if isinstance(n, tl.constexpr) else n for n in shape)
        if key not in types:
            new_type(self, element_ty, shape)
            types[key] = self.element_ty, self.shape, self.numel, self.name
        self.element_ty, self.shape, self.numel, self.name = types[key]

    tl.block_type.__init__ = block_type
    interpreter._get_np_dtype, interpreter._patch_lang, launch.__call__ = np_dtype_of, patch_once, execute_patched
