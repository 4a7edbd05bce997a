"""Attention in blocks against its equation: one lit pixel, a loop, borders, odd sizes, gradients."""

import math

import pytest
import torch

from rtdenoise.ops import attend_blocks, use
from rtdenoise.ops import attend_blocks as attend_blocks_op  # noqa: F401
