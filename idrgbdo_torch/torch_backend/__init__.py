"""The functions of kernels/ in plain torch, by name and argument: the definition, for backend = "torch".

Each file stands for the kernel file of its name, takes the same numpy arrays and gives the same results; what is not
here (Algorithm 1, poses, linear algebra) has its torch definition in selection.py, se3.py and solver.py.
"""
