"""Blocks: every model, inverse, controller and observer is a kernel over plain arrays with a small class around it.

A *kernel* is a function ``y = kernel(p, x, u)`` over contiguous float64 arrays: parameters ``p`` (read only), state
``x`` (updated in place), input ``u`` and output ``y`` scalars. Controllers are ``u = kernel(p, x, r, y)``. Kernels
allocate nothing and know nothing of ROS. With Numba (optional extra ``fast``) the same source is compiled; without it
the same source runs as plain Python and agrees to 1e-12 of full scale.

A *composite* connects kernels that it receives as arguments (plant, compensator, closed loop). Offline loops run it
compiled; a node, which calls once per sample, runs its Python form over the compiled kernels, because handing
functions to compiled code costs 25 µs a call and a compiled kernel 0.2 µs. Both forms do the same IEEE arithmetic in
the same order, so their results are equal bit for bit.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pathlib
import shutil
import time

import numpy as np

try:
    import numba
except ImportError:  # the optional extra `fast` is not installed
    numba = None

#: True when kernels are compiled.
COMPILED = numba is not None and not numba.config.DISABLE_JIT

# Kernels allocate nothing, so nobody has to count references to their arrays: left on, the counting (atomic) costs a
# small kernel up to nine tenths of its time. Off (`_nrt`), a kernel that allocates after all does not compile.
_OPTIONS = {"cache": True, "error_model": "numpy", "_nrt": False}


@contextlib.contextmanager
def _cache_directory():
    """Point Numba at a cache of this very source while a kernel is declared.

    Numba notices changes of the file a function stands in but not of the functions it calls, so a cache beside the
    sources would serve stale code after an update; a folder named by a digest of all sources cannot.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        yield
        return
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


#: Folders of the package whose kernels are compiled; the digest is over their sources.
KERNEL_FOLDERS = (".", "models", "compensation", "control", "references", "simulation")

#: Days after which the cache of an older source is removed.
CACHE_DAYS = 30


@functools.cache
def _cache() -> pathlib.Path:
    """Return the cache folder of these sources; caches of others that nobody used for long are removed."""
    base = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    root = pathlib.Path(base) / "hysteresis_ros"
    package = pathlib.Path(__file__).parent
    digest = hashlib.sha1(str(package).encode())
    for folder in KERNEL_FOLDERS:
        for path in sorted((package / folder).glob("*.py")):
            digest.update(path.read_bytes())
    chosen = root / digest.hexdigest()[:16]
    # a cache is a convenience: where it cannot be tidied or touched, everything works all the same
    with contextlib.suppress(OSError):
        oldest = time.time() - CACHE_DAYS * 86400
        for other in root.iterdir():
            if other != chosen and other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
    with contextlib.suppress(OSError):
        os.utime(chosen)
    return chosen


def kernel(function):
    """Mark ``function`` as a kernel or composite: compiled on first use when Numba is there, unchanged otherwise."""
    if not COMPILED:
        return function
    with _cache_directory():
        # inlined, because handing arrays (seven words each) from kernel to kernel costs more than a small kernel itself
        return numba.njit(forceinline=True, **_OPTIONS)(function)


def nested(function):
    """Mark a composite that other composites call: compiled with them, and never cached by itself.

    A cache entry for "this function with that kernel as argument" would hold a weak reference to the kernel, which
    breaks the cache when the kernel is gone. Do not call it from Python with kernels; call ``interpreted(function)``.
    """
    return numba.njit(forceinline=True, **{**_OPTIONS, "cache": False})(function) if COMPILED else function


def interpreted(function):
    """Return the Python form of a composite, for callers that call it once per sample."""
    return getattr(function, "py_func", function)


def signature(*names: str):
    """Return the Numba signature made of words.

    The words: ``void``, ``integer``, ``scalar``, ``array``, ``table``, ``arrays:N`` (a tuple of N), ``kernel``,
    ``controller`` and ``inverse``.
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
        if name.startswith("arrays:"):
            return numba.types.UniTuple(array, int(name.split(":")[1]))
        return kinds[name]

    result, *arguments = names
    return kind(result)(*map(kind, arguments))


def composite(*names: str):
    """Mark a function that takes kernels as arguments, with its signature in the words of :func:`signature`.

    One machine code serves every combination of kernels, because they arrive as first-class functions. It is compiled
    (or read from the cache) at the first call of :func:`compiled`.
    """

    def mark(function):
        function.composite_signature = names
        return function

    return mark


_compiled: dict = {}


def compiled(function):
    """Return the machine-code form of a composite (the function itself without Numba)."""
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
    """Fill ``y[k] = step(p, x, u[k])`` for all k."""
    for k in range(u.shape[0]):
        y[k] = step(p, x, u[k])


class Chain:
    """Several blocks that work as one; ``xs`` holds the state arrays of its parts."""

    xs: tuple[np.ndarray, ...]

    @property
    def state(self) -> np.ndarray:
        """A copy of all states in one array; assign it to restore exactly (with the same parameters)."""
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

    kernel = None

    def __init__(self, parameters, sample_time: float):
        self.parameters = parameters.validated()
        self.sample_time = float(sample_time)
        self.p = np.ascontiguousarray(self.pack(self.parameters), dtype=np.float64)
        self.x = np.ascontiguousarray(self.initial_state(), dtype=np.float64)

    def pack(self, parameters) -> np.ndarray:
        """Return the kernel's parameter array."""
        raise TypeError(f"{type(self).__name__} does not say how its parameters are packed")

    def initial_state(self) -> np.ndarray:
        """Return the kernel's state array at rest."""
        return np.zeros(1)

    def step(self, u: float) -> float:
        """Advance by one sample with input ``u`` and return the output."""
        return self.kernel(self.p, self.x, float(u))

    def simulate(self, u) -> np.ndarray:
        """Return the output, shape (N,), for the inputs ``u``, shape (N,); the state goes on from where it was."""
        u = np.ascontiguousarray(u, dtype=np.float64)
        y = np.empty_like(u)
        compiled(run_kernel)(self.kernel, self.p, self.x, u, y)
        return y

    def reset(self) -> None:
        """Return to the state at rest."""
        self.x[:] = self.initial_state()

    @property
    def state(self) -> np.ndarray:
        """A copy of the state array; assign it to restore exactly."""
        return self.x.copy()

    @state.setter
    def state(self, value) -> None:
        self.x[:] = value

    def retune(self, parameters) -> None:
        """Take new parameters of the same structure while running, without a jump in the output.

        Raises
        ------
        ParameterError
            The parameters are wrong; the block is unchanged then.
        """
        packed = np.ascontiguousarray(self.pack(parameters.validated()), dtype=np.float64)
        self.parameters = parameters
        self.p[:] = packed
