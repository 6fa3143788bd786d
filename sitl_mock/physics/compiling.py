"""Machine code of the physics: compiled at the first call of a kernel, kept beside the sources.

The compiler's cache goes by the file of the outermost kernel, so all kernels that call each other are in one file. This
module loads the compiler, which takes a quarter of a second: it is imported when a simulator is made, not before.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from numba import njit

# One row of a table of `records`, by reference: mypy does not see fields of NumPy records.
Row = Any

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def kernel(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Compile a function that Python calls; its code is kept."""
    compiled: Callable[_Arguments, _Result] = njit(cache=True, error_model="numpy")(function)
    return compiled


def part(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Compile a function that only kernels call: it becomes part of theirs."""
    compiled: Callable[_Arguments, _Result] = njit(error_model="numpy")(function)
    return compiled
