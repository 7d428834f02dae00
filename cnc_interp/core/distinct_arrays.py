"""
A compiler for kernels whose array arguments never overlap.

The compiler computes several elements of a loop at once only if it knows that no array written by
the loop overlaps another one. For ten or more arrays it gives up asking at run time. A kernel with
``pipeline_class=DistinctArrays`` promises it: no array that it writes overlaps another argument.
"""

from numba.core.compiler import CompilerBase, DefaultPassBuilder


class DistinctArrays(CompilerBase):  # type: ignore[misc]
    """The usual compiler, told that array arguments do not overlap."""

    def define_pipelines(self):  # type: ignore[no-untyped-def]
        """Return the usual passes."""
        self.state.flags.noalias = True
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]
