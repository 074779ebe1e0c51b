"""Fused CPU twins of the inner loops that are too small for torch; each is tested equal to its torch definition.

Serial on purpose: two dozen points are too few to share between threads, and serial code gives the same bits on any
number of them. Compiled once and cached on disk.
"""
