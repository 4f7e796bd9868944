# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Blocks: every model, inverse, controller and observer is a kernel on plain arrays with a small class around it.

A *kernel* is a function ``y = kernel(p, x, u)`` of contiguous float64 arrays: ``p`` contains the parameters (read
only), ``x`` the state (updated in place); input ``u`` and output ``y`` are scalars. The kernel of a controller is ``u =
kernel(p, x, r, y)`` with reference r and measurement y. Kernels allocate nothing and do not depend on ROS. With Numba
(optional extra ``fast``) this source is compiled; without Numba it runs as plain Python, and the results agree to 1e-12
of full scale.

A *composite* connects kernels that it receives as arguments (plant, compensator, closed loop). Offline loops run its
compiled form. A node runs its Python form with compiled kernels once per sample, because passing functions to compiled
code takes 25 µs per call, and calling a compiled kernel only 0.2 µs. Both forms do the same IEEE arithmetic in the same
order, so their results are equal bit for bit.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pathlib
import platform
import shutil
import sys
import time
import types
from typing import Any

import numpy as np

numba: Any
try:
    import numba
    from numba.core import cgutils
    from numba.extending import (
        NativeValue,
        lower_builtin,
        models,
        overload,
        register_jitable,
        register_model,
        type_callable,
        typeof_impl,
        unbox,
    )
except ImportError:  # the optional extra `fast` is not installed
    numba = None

#: Whether kernels are compiled.
COMPILED = numba is not None and not numba.config.DISABLE_JIT


def _leave_blas_for_later() -> None:
    """Import the modules that Numba imports for its first kernel, except the linear algebra of SciPy.

    Numba imports SciPy's linear algebra to look for a BLAS, which takes a seventh of a node's start time. No kernel
    here uses a BLAS. A placeholder in the module table prevents this import; code that uses a BLAS still imports it
    later.
    """
    name = "scipy.linalg.cython_blas"
    if name in sys.modules:
        return
    sys.modules[name] = types.ModuleType(name)
    try:
        # another version of Numba may lack this module
        with contextlib.suppress(ImportError):
            import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules[name]


if COMPILED:
    _leave_blas_for_later()

# Kernels allocate nothing, so the references to their arrays need not be counted: the (atomic) counting takes up to 90
# % of the time of a small kernel. With counting off (`_nrt`), a kernel that allocates does not compile.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
# Options of functions that only compiled code calls: they get no entry points for Python and C, which take time to
# compile.
_WITHIN: dict[str, Any] = {
    "error_model": "numpy",
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
_BY_PART: Any = {"forceinline": True, **_WITHIN}
_EACH: Any = _WITHIN


@contextlib.contextmanager
def _cache_directory():
    """Make Numba use the cache folder of these sources while a kernel is declared.

    Numba detects changes of a function's own file, but not of the functions that it calls. A cache next to the sources
    would therefore return stale code after an update. A folder named after a digest of all sources prevents this.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        yield
        return
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


#: Folders of the package with kernels that are compiled; the digest includes all their sources.
KERNEL_FOLDERS = (".", "models", "control", "references", "loop")

#: Number of days after which an unused cache of older sources is removed.
CACHE_DAYS = 30


@functools.cache
def cache_folder() -> pathlib.Path:
    """Return the folder with the machine code of these sources; remove unused folders of older sources."""
    base = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    root = pathlib.Path(base) / "hysteresis_ros"
    package = pathlib.Path(__file__).parents[1]
    digest = hashlib.sha1(str(package).encode())
    for folder in KERNEL_FOLDERS:
        for path in sorted((package / folder).glob("*.py" if folder == "." else "**/*.py")):
            digest.update(path.read_bytes())
    chosen = root / digest.hexdigest()[:16]
    # the clean-up is optional, so errors are ignored
    with contextlib.suppress(OSError):
        oldest = time.time() - CACHE_DAYS * 86400
        for other in root.iterdir():
            if other != chosen and other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
    with contextlib.suppress(OSError):
        root.mkdir(mode=0o700, parents=True, exist_ok=True)  # machine code: no other user may write here
        os.utime(chosen)
    return chosen


def kernel(function):
    """Mark ``function`` as a kernel or composite: compiled on first use with Numba, unchanged without it."""
    # inlined, because passing arrays (seven words each) between kernels takes longer than a small kernel itself
    return _in_two_forms(function, forceinline=True)


def called(function):
    """Mark a kernel that other kernels call and do not inline; for long kernels that are seldom executed completely."""
    return _in_two_forms(function)


def _in_two_forms(function, **options):
    """Return the form of a kernel that Python calls or passes as an argument; other kernels call another form.

    Each form is compiled on first use. Therefore a kernel that only kernels call gets no entry points and no cache
    file.
    """
    if not COMPILED:
        return function
    with _cache_directory():
        form = numba.njit(**_OPTIONS)(function)
    form.within = functools.cache(lambda: numba.njit(**options, **_WITHIN)(function))
    return form


if COMPILED:

    class _Within(numba.types.Dispatcher):
        """Type of a kernel that another kernel calls by name; calls with different literal numbers share one form."""

        def get_call_type(self, context, args, kws):
            unliteral = numba.types.unliteral
            named = {name: unliteral(kind) for name, kind in kws.items()}
            return super().get_call_type(context, tuple(map(unliteral, args)), named)

    register_model(_Within)(models.OpaqueModel)

    @typeof_impl.register(type(numba.njit(lambda: None)))
    def _type_of_compiled(value, context):
        """Return the type of a compiled function; in the source of another function, the type of its internal form."""
        within = getattr(value, "within", None) if context.purpose.name == "constant" else None
        return numba.types.Dispatcher(value) if within is None else _Within(within())


def nested(function):
    """Mark a composite that other composites call: it is compiled as part of them, and Python calls it as plain Python.

    If Python calls it, its kernels are passed as compiled functions (0.2-0.3 µs per call of a kernel).
    """
    if COMPILED:
        register_jitable(forceinline=True, **_WITHIN)(function)
        # Numba inlines a function with this attribute. Without it, each level would also be compiled separately,
        # including all levels below it, which takes a third of the time of a cold start. A version of Numba that
        # ignores the attribute uses the form that is registered above.
        function.targetoptions, function.py_func = {"inline": "always"}, function
    return function


def by_part(function):
    """Mark a composite that exists in one form for each kind of part; the type of ``part`` decides which form runs.

    ``function(laws, part, row)`` gets an attribute ``kinds``: a dict from classes of parts (named tuples of arrays) to
    composites with the same arguments. The form is chosen at compile time, so the choice takes no time in a sample.
    """
    kinds: dict = {}

    def chosen(laws, part, row):
        return kinds[type(part)](laws, part, row)

    choose: Any = chosen
    choose.kinds = kinds
    choose.__name__ = choose.__qualname__ = function.__name__
    choose.__doc__, choose.__module__ = function.__doc__, function.__module__
    if COMPILED:
        # the names are not compared, because the forms may name their arguments differently
        @overload(choose, jit_options=_BY_PART, strict=False)
        def compiled_form(laws, part, row):
            return kinds[part.instance_class]

    return choose


def each(function):
    """Mark a composite ``function(laws, parts, row)`` of one axis, so that it runs for all axes of a stage.

    The resulting function takes a tuple of laws, a tuple of parts, and a table with one row for each axis, in the same
    order. The compiled form divides the tuples into halves, so the axes may have parts of different classes. Axes, or
    halves, with the same classes share machine code.
    """

    def over(laws, parts, rows):
        for i in range(len(parts)):
            function(laws[i], parts[i], rows[i])

    all_axes: Any = over
    all_axes.__name__ = all_axes.__qualname__ = function.__name__
    all_axes.__doc__, all_axes.__module__ = function.__doc__, function.__module__
    if COMPILED:
        one = numba.njit(**_WITHIN)(function)

        @overload(all_axes, jit_options=_EACH, strict=False)
        def compiled_form(laws, parts, rows):
            if len(parts) == 1:
                return lambda laws, parts, rows: one(laws[0], parts[0], rows[0])

            half = len(parts) // 2

            def both_halves(laws, parts, rows):
                all_axes(laws[:half], parts[:half], rows[:half])
                all_axes(laws[half:], parts[half:], rows[half:])

            return both_halves

    return all_axes


class Stored:
    """Arguments of compiled code that are unpacked once instead of at every call; :func:`contents` returns them.

    Parameters
    ----------
    *arguments
        Arrays, named tuples of arrays, and named tuples marked by :func:`kernels_of`.
    """

    def __init__(self, *arguments):
        self.arguments = arguments
        if COMPILED:
            self._memory = np.zeros(_WORDS * _leaves(arguments))
            self.address = self._memory.ctypes.data
            specialised(_store, self._memory, arguments)(self._memory, arguments)


#: Maximum number of words of an array or a function in compiled code.
_WORDS = 16


def _leaves(argument) -> int:
    return sum(map(_leaves, argument)) if isinstance(argument, tuple) else 1


def contents(stored):
    """Return the arguments of :class:`Stored`."""
    return stored.arguments


def _written(memory, arguments):
    """Write arguments into the memory of :class:`Stored`; for compiled code only."""


def _store(memory, arguments):
    _written(memory, arguments)


if COMPILED:

    class _StoredType(numba.types.Type):
        """Type of stored arguments."""

        def __init__(self, kind):
            self.kind = kind
            super().__init__(name=f"stored({kind})")

    register_model(_StoredType)(models.OpaqueModel)
    typeof_impl.register(Stored)(lambda value, context: _StoredType(numba.typeof(value.arguments)))

    @unbox(_StoredType)
    def _unbox_stored(kind, value, c):
        address = c.pyapi.object_getattr_string(value, "address")
        pointer = c.pyapi.long_as_voidptr(address)
        c.pyapi.decref(address)
        return NativeValue(pointer)

    @type_callable(_written)
    def _type_of_written(context):
        return lambda memory, arguments: numba.types.none

    @lower_builtin(_written, numba.types.Array, numba.types.BaseTuple)
    def _write(context, builder, signature, arguments):
        memory = context.make_array(signature.args[0])(context, builder, arguments[0])
        builder.store(arguments[1], builder.bitcast(memory.data, arguments[1].type.as_pointer()))
        return context.get_dummy_value()

    @type_callable(contents)
    def _type_of_contents(context):
        return lambda stored: stored.kind

    @lower_builtin(contents, _StoredType)
    def _read(context, builder, signature, arguments):
        """Read every word separately, so that the compiler can omit the unused words."""
        zero = context.get_constant(numba.types.int32, 0)

        def read(pointer):
            kind = pointer.type.pointee
            if not hasattr(kind, "elements") and not hasattr(kind, "count"):
                return builder.load(pointer)
            found = cgutils.get_null_value(kind)
            for i in range(len(kind)):
                inner = read(builder.gep(pointer, [zero, context.get_constant(numba.types.int32, i)]))
                found = builder.insert_value(found, inner, i)
            return found

        kind = context.get_value_type(signature.return_type)
        return read(builder.bitcast(arguments[0], kind.as_pointer()))


def displaced(arrays, distance):
    """Return named tuples with arrays that lie ``distance`` numbers after the given arrays in the same block of memory.

    All arrays are slices of one float64 array. Compiled code only moves pointers, which takes hardly any time.
    """
    if isinstance(arrays, tuple):
        return type(arrays)(*(displaced(array, distance) for array in arrays))
    place = (arrays.__array_interface__["data"][0] - arrays.base.__array_interface__["data"][0]) // arrays.itemsize
    return arrays.base[place + distance : place + distance + arrays.size].reshape(arrays.shape)


if COMPILED:

    @type_callable(displaced)
    def _type_of_displaced(context):
        """Return the type of the displaced arrays, which is the type of the given arrays."""
        return lambda arrays, distance: arrays

    @lower_builtin(displaced, numba.types.BaseTuple, numba.types.Integer)
    def _displaced(context, builder, signature, arguments):
        """Move the pointers of all arrays."""
        distance = context.cast(builder, arguments[1], signature.args[1], numba.types.intp)

        def moved(kind, value):
            if isinstance(kind, numba.types.BaseTuple):
                parts = [moved(inner, builder.extract_value(value, i)) for i, inner in enumerate(kind.types)]
                return context.make_tuple(builder, kind, parts)
            array = context.make_array(kind)(context, builder, value)
            array.data = builder.gep(array.data, [distance])
            return array._getvalue()

        return moved(signature.return_type, arguments[0])


def interpreted(function):
    """Return the Python form of a kernel or composite."""
    return getattr(function, "py_func", function)


def kernels_of(*names: str):
    """Mark a named tuple of kernels as one argument of compiled code; ``names`` are their :func:`signature` words.

    The kernels in the tuple are first-class functions, so the same machine code works with any kernels.
    """

    def mark(cls):
        if COMPILED:
            kind = numba.types.NamedTuple(tuple(signature("void", *names).args), cls)
            typeof_impl.register(cls)(lambda value, context: kind)
        return cls

    return mark


def specialised(function, *arguments):
    """Return the machine code of a composite for arguments of these types; without Numba, the function itself.

    The machine code releases Python's lock while it runs, so a loop with a driver written in Python need not wait.

    Parameters
    ----------
    function : function
        Plain function; it is compiled once for each combination of types and cached on disk.
    *arguments
        Arguments with which it will be called: arrays, named tuples of arrays, named tuples marked by
        :func:`kernels_of`, and results of this function.
    """
    if not COMPILED:
        return function
    key = function, _structure(arguments)
    if key not in _compiled:
        kinds = numba.void(*map(_type_of, arguments))
        with _cache_directory():
            _compiled[key] = numba.njit(kinds, nogil=True, **_OPTIONS)(function)
        with contextlib.suppress(OSError):
            _mark_of(function, arguments).touch()
    return _compiled[key]


#: Number of samples that are interpreted before a loop is compiled: compiling takes as long as some 200 000 samples.
INTERPRETED = 20_000

_interpreted: dict = {}


def specialised_for(samples: int, function, *arguments):
    """Return the faster way to run ``samples`` more samples: machine code of a composite, or the function itself.

    Both give identical results. The function itself is returned if neither this process nor the cache has machine code
    for these arguments, and fewer than :data:`INTERPRETED` samples were run with arguments of these types.
    """
    if not COMPILED:
        return function
    key = function, _structure(arguments)
    if key not in _compiled:
        if key not in _interpreted:
            _interpreted[key] = INTERPRETED if _mark_of(function, arguments).exists() else 0
        _interpreted[key] += samples
        if _interpreted[key] < INTERPRETED:
            return function
    return specialised(function, *arguments)


def _mark_of(function, arguments) -> pathlib.Path:
    """Return the path of a file that is in the cache if the cache has machine code for these arguments."""
    kinds = " ".join(str(_type_of(argument)) for argument in arguments)
    name = f"{function.__qualname__} {kinds} {numba.__version__} {sys.version} {platform.machine()}"
    return pathlib.Path(os.environ.get("NUMBA_CACHE_DIR") or cache_folder()) / hashlib.sha1(name.encode()).hexdigest()


def direct(function):
    """Return a result of :func:`specialised` in a form that does not look up the types of its arguments in each call.

    The look-up takes a millisecond for all arrays of an axis. The form checks neither whether the arguments have the
    types for which it was compiled, nor whether arrays are contiguous.
    """
    return function.get_overload(function.nopython_signatures[0]) if COMPILED else function


def _type_of(argument):
    """Return Numba's type of an argument; compiled functions are first-class functions."""
    if hasattr(argument, "nopython_signatures"):
        return numba.types.FunctionType(argument.nopython_signatures[0])
    return numba.typeof(argument)


def _structure(argument):
    """Return a key for the type of an argument: classes of tuples, and dimensions of arrays."""
    if isinstance(argument, Stored):
        return Stored, _structure(argument.arguments)
    if isinstance(argument, tuple):
        return type(argument), tuple(map(_structure, argument))
    return getattr(argument, "ndim", None) or type(argument)


def signature(*names):
    """Return the Numba signature for words: the type of the result, then the types of the arguments.

    The words are ``void``, ``integer``, ``scalar``, ``array``, ``table``, ``kernel``, ``controller`` and ``inverse``. A
    class of named tuples whose fields are all arrays may replace a word.
    """
    scalar, array = numba.float64, numba.float64[::1]
    kinds = {
        "void": numba.void,
        "integer": numba.int64,
        "scalar": scalar,
        "array": array,
        "table": numba.float64[:, ::1],
        "kernel": numba.types.FunctionType(scalar(array, array, scalar)),
        "controller": numba.types.FunctionType(scalar(array, array, scalar, scalar)),
    }
    kinds["inverse"] = numba.types.FunctionType(scalar(kinds["kernel"], *4 * (array,), scalar))

    def kind(name):
        if isinstance(name, type):
            fields: Any = name
            return numba.types.NamedUniTuple(array, len(fields._fields), name)
        return kinds[name]

    result, *arguments = names
    return kind(result)(*map(kind, arguments))


def composite(*names):
    """Mark a function that takes kernels as arguments, with its signature in the words of :func:`signature`.

    The same machine code works with every combination of kernels, because kernels are first-class functions. The code
    is compiled, or read from the cache, at the first call of :func:`compiled`.
    """

    def mark(function):
        function.composite_signature = names
        return function

    return mark


_compiled: dict = {}


def compiled(function):
    """Return the machine-code form of a composite; without Numba, the function itself."""
    if not COMPILED:
        return function
    if function not in _compiled:
        with _cache_directory():
            _compiled[function] = numba.njit(signature(*function.composite_signature), **_OPTIONS)(function)
    return _compiled[function]


#: Words of the signature of every inverse: ``inverse(hysteresis, p_i, x_i, p_h, x_h, displacement)``.
INVERSE = ("scalar", "kernel", "array", "array", "array", "array", "scalar")


@composite("void", "kernel", "array", "array", "array", "array")
def run_kernel(step, p, x, u, y):
    """Set ``y[k] = step(p, x, u[k])`` for every k."""
    for k in range(u.shape[0]):
        y[k] = step(p, x, u[k])


class Chain:
    """Several blocks combined; ``xs`` contains the state arrays of the blocks."""

    #: Named tuple of the state arrays of the blocks.
    xs: Any

    @property
    def state(self) -> np.ndarray:
        """Copy of all states in one array; assign it to restore the states exactly (with the same parameters)."""
        return np.concatenate(self.xs)

    @state.setter
    def state(self, value) -> None:
        first = 0
        for x in self.xs:
            x[:] = value[first : first + len(x)]
            first += len(x)


class Block:
    """A kernel with its parameters and state.

    Subclasses set ``kernel`` (a static method) and implement :meth:`pack` and :meth:`initial_state`.

    Parameters
    ----------
    parameters : Parameters
        Typed parameters, checked on construction.
    sample_time : float
        Sample time [s].

    Raises
    ------
    ParameterError
        A parameter is missing, out of range or inconsistent.
    """

    #: The kernel, a static method of each subclass.
    kernel: Any = None

    def __init__(self, parameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.p = np.ascontiguousarray(self.pack(self.parameters), dtype=np.float64)
        self.x = np.ascontiguousarray(self.initial_state(), dtype=np.float64)

    def pack(self, parameters) -> np.ndarray:
        """Return the kernel's parameter array."""
        raise TypeError(f"{type(self).__name__} does not define pack(), which packs its parameters")

    def initial_state(self) -> np.ndarray:
        """Return the kernel's state array at rest."""
        return np.zeros(1)

    def step(self, u: float) -> float:
        """Advance by one sample with input ``u`` and return the output."""
        return self.kernel(self.p, self.x, float(u))

    def simulate(self, u) -> np.ndarray:
        """Return the outputs, shape (N,), for the inputs ``u``, shape (N,), starting at the present state."""
        u = np.ascontiguousarray(u, dtype=np.float64)
        y = np.empty_like(u)
        compiled(run_kernel)(self.kernel, self.p, self.x, u, y)
        return y

    def reset(self) -> None:
        """Return to the state at rest."""
        self.x[:] = self.initial_state()

    @property
    def state(self) -> np.ndarray:
        """Copy of the state array; assign it to restore the state exactly."""
        return self.x.copy()

    @state.setter
    def state(self, value) -> None:
        self.x[:] = value

    def retune(self, parameters) -> None:
        """Change to parameters of the same structure while running, without a jump in the output.

        Raises
        ------
        ParameterError
            The parameters are wrong; the block then remains unchanged.
        """
        packed = np.ascontiguousarray(self.pack(parameters.validated()), dtype=np.float64)
        self.parameters = parameters
        self.p[:] = packed
