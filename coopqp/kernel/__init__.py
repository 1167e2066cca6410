"""The compiled tick: C++ in ``core/``, and the thin Python side that fills its arrays.

native   finds the compiled module, if there is one
flat     a problem as flat arrays
levels   the tasks of a problem as levels of rows, and who fills them
fit      what the kernel can do, and why it cannot do the rest
law      the law: a tick by the kernel, or by the plain law where the kernel has no answer
"""
