"""Fused ops for CUDA, in Triton.

An op has the same name here as in `rtdenoise.ops`, whose function checks the arguments and calls it through
`ops.dispatch`. `common`, `pool`, `targets`, `alike` and `luminance` hold device functions that several share. Sums and
weights are float32 whatever the dtype of the logits.

Most programs compute `common.BLOCK` neighbouring pixels of one row, all channels at once: tiles are [BLOCK] or [BLOCK,
CP], where CP is the number of channels rounded up to a power of two. With TRITON_INTERPRET=1 the same code runs on the
CPU, slowly.
"""
