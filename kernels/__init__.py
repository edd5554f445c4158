"""Warp kernels and device functions; see README.md in this folder for the rules they keep.

Every file has one ``build(scalar)``: it makes the file's kernels in one precision, as a Warp module of their own, so
that a float32 and a float64 run never recompile each other.
"""
