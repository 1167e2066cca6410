"""The compiled tick: C++ in ``core/``, and the thin Python side that fills its arrays.

native                 finds the compiled module, if there is one, and says what it cannot do
flat                   a problem and its tasks as flat arrays
compiled               one program of the kernel: levels of tasks and limits, and who fills them
law                    the law: a tick by the kernel, or by the plain law where it has no answer
free_space             distances of bodies, and whether configurations keep them
trajectory_evaluation  errors, object and loops along a recorded motion
"""
