"""Sizes and types of the tests of fused ops."""

import torch

SIZES = [(1, 1), (1, 9), (17, 5), (6, 3), (59, 161)]
CASES = [("native", size) for size in SIZES]
CASES += [("triton", size) for size in [(1, 1), (3, 4), (1, 141)]]  # the interpreter takes its time; 141 > BLOCK
DTYPES = (torch.float32, torch.bfloat16, torch.float16)
