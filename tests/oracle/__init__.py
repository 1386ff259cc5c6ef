"""Inference in numpy, as the C kernels do it in src/motionkit/inference: what they are compared with, step by step."""
