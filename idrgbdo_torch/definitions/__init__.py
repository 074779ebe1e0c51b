"""The method in batched torch, any leading dimensions, differentiable: what the equations mean.

kernels/ has a fused twin of each file whose functions run for every frame; tests hold the two together.
"""
