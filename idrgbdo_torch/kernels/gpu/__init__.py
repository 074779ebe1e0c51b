"""The search of a batch of pairs on a GPU, one program a pair, in Triton: twins of definitions.tracking and its floor.

Nothing else of the package imports this folder but tracker/gpu.py, and that only where tensors lie on a GPU.
"""
