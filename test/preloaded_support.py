# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""Processes of this package without the time for imports: forked from a process that has imported everything.

A node or a command spends most of its processor time on importing Numba, SciPy, rclpy and this package, and a run of
the tests starts hundreds of them. After :func:`install`, a ``subprocess.Popen`` of ``python -m hysteresis_ros.…`` is a
fork of a process that has imported them, and becomes a child of this process. Everything else is unchanged: identifier,
arguments, environment, folder, pipes, session, signals and exit code; the module runs as ``__main__``. Only the
objects of Python are not freed when it ends. A process of ``STARTERS``, which starts others itself, keeps a copy of
its state before it runs, from which these are forked.

A start that could differ by its imports is not replaced: another interpreter, environment variables other than
``HARMLESS``, another copy of the package in the path, the user's modules in the folder. With ``HYSTERESIS_COLD=1`` no
start is replaced; the marker ``cold`` has this effect for a single test.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import importlib
import importlib.util
import inspect
import io
import json
import os
import pathlib
import pickle
import pkgutil
import runpy
import signal
import socket
import subprocess
import sys
import threading
import warnings

PACKAGE = "hysteresis_ros"
#: Variables that are read when a process runs, not when it imports modules.
HARMLESS = frozenset(
    {"ROS_DOMAIN_ID", "HYSTERESIS_DOMAIN", "ROS_AUTOMATIC_DISCOVERY_RANGE", "PYTEST_CURRENT_TEST"}
    | {"PYTHONUNBUFFERED", "PYTHONSAFEPATH", "PYTHONPATH"}
)
#: Modules whose processes start others of the package.
STARTERS = frozenset({"hysteresis_ros.cli.main", "hysteresis_ros.cli.entry", "hysteresis_ros.laboratory.campaign.run"})
#: Modules of ROS that nodes import.
ROS = (
    *("rclpy.lifecycle", "rclpy.action", "rclpy.executors", "rclpy.experimental"),
    *("sensor_msgs.msg", "diagnostic_msgs.msg", "std_srvs.srv", "rcl_interfaces.srv", "lifecycle_msgs.srv"),
)
#: Environment variable with which no start is replaced.
COLD = "HYSTERESIS_COLD"

_PR_SET_CHILD_SUBREAPER = 36
_true_start = subprocess.Popen._execute_child
_lock = threading.Lock()


class _Starter:
    """The process that has imported everything, and the conditions of its start."""

    def __init__(self, channel: socket.socket, process: subprocess.Popen | None = None):
        self.environment = _usual_environment()
        self.pid = os.getpid()
        self._socket, self._process = channel, process

    @classmethod
    def started(cls) -> _Starter:
        """Start the process that imports everything."""
        ours, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        with other:
            command = [sys.executable, __file__, str(other.fileno()), str(tested_folder())]
            os.set_inheritable(other.fileno(), True)
            process = subprocess.Popen(
                command, pass_fds=(other.fileno(),), stdin=subprocess.DEVNULL, env=_usual_environment()
            )
        return cls(ours, process)

    def fork(self, request: dict, files: list[int]) -> int:
        """Return the identifier of a new child of this process."""
        message = json.dumps(request).encode()
        libc = ctypes.CDLL(None)
        # the intermediate process has exited when the answer comes, so its child becomes a child of this process
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 1)
        try:
            socket.send_fds(self._socket, [len(message).to_bytes(8, "little")], files)
            self._socket.sendall(message)
            answer = self._socket.recv(8, socket.MSG_WAITALL)
        finally:
            libc.prctl(_PR_SET_CHILD_SUBREAPER, 0)
        if len(answer) < 8:
            raise OSError("the process that forks others has ended")
        return int.from_bytes(answer, "little")

    def close(self) -> None:
        """End the process."""
        self._socket.close()
        if self._process is not None:
            self._process.wait()


_starter: _Starter | None = None
_cold = False
_usual: dict[str, str] = {}


def remember_environment() -> None:
    """Store the current environment as that of the test that begins; later changes count as changes by the test."""
    _usual.clear()
    _usual.update(os.environ)


def _usual_environment() -> dict[str, str]:
    return dict(_usual or os.environ)


def tested_folder() -> pathlib.Path:
    """Return the folder in which this package lies, as the tests import it."""
    return pathlib.Path(importlib.util.find_spec(PACKAGE).origin).resolve().parents[1]


def _path_of(environment: dict, cwd) -> list[str] | None:
    """Return the beginning of an interpreter's path, or None if its modules could differ from ours."""
    folder = os.path.abspath(cwd or os.getcwd())
    own = [] if environment.get("PYTHONSAFEPATH") else [folder]
    path = own + [entry for entry in environment.get("PYTHONPATH", "").split(os.pathsep) if entry]
    home = tested_folder()
    for entry in map(pathlib.Path, path):
        if entry.resolve() == home:
            return path
        if any(entry.glob("*.py")) or (entry / PACKAGE).exists():
            return None
    return path if "site-packages" in home.parts else None


def _fits(args, environment: dict) -> bool:
    """Return whether a process with this command line and environment may be forked."""
    if _cold or os.environ.get(COLD) or sys.platform != "linux" or not isinstance(args, list | tuple):
        return False
    words = [os.fspath(word) for word in args]
    if words[:2] != [sys.executable, "-m"] or not words[2].startswith(f"{PACKAGE}."):
        return False
    return not _changed(environment, _usual_environment())


def _changed(environment: dict, known: dict) -> set[str]:
    """Return the changed variables that may affect imports."""
    return {name for name in (environment.keys() | known.keys()) - HARMLESS if environment.get(name) != known.get(name)}


def _start(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *rest):
    """Fork if it makes no difference; replaces :meth:`subprocess.Popen._execute_child`."""
    global _starter
    startupinfo, creationflags, shell, *pipes = rest[:9]
    restore_signals, gid, gids, uid, umask, start_new_session, process_group = rest[9:]
    environment = dict(os.environ if env is None else env)
    plain = (gid, gids, uid, umask, process_group) == (None, None, None, -1, -1) and restore_signals and close_fds
    path = None
    if plain and not shell and not pass_fds and executable in (None, sys.executable) and _fits(args, environment):
        path = _path_of(environment, cwd)
    try:
        first = pickle.dumps(preexec_fn).hex() if path is not None else ""
    except (AttributeError, TypeError, pickle.PicklingError):
        path = None
    if path is None:
        return _true_start(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *rest)
    p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite = pipes
    given = [file if file != -1 else standard for standard, file in enumerate((p2cread, c2pwrite, errwrite))]
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):
            stream.flush()
    request = {
        "arguments": [os.fspath(word) for word in args[3:]],
        "module": args[2],
        "environment": environment,
        "cwd": os.path.abspath(cwd or os.getcwd()),
        "path": path,
        "session": bool(start_new_session),
        "first": first,
        "parent": os.getpid(),
    }
    with _lock:
        if (
            _starter is not None
            and _starter.pid == os.getpid()
            and _changed(_starter.environment, _usual_environment())
        ):
            _starter.close()  # an earlier test, or a library that it imported, has set a variable
            _starter = None
        if _starter is None or _starter.pid != os.getpid():
            _starter = _Starter.started()
        try:
            self.pid = _starter.fork(request, given)
        except OSError as error:
            warnings.warn(f"processes are started truly, which takes longer: {error}", stacklevel=2)
            start_cold(True)
            return _true_start(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *rest)
    self._child_created = True
    with contextlib.ExitStack() as stack:
        # the ends of the child, and those that it keeps of a file given by the caller, as Popen itself leaves them
        devnull = getattr(self, "_devnull", None)
        if p2cread != -1 and p2cwrite != -1 and p2cread != devnull:
            stack.callback(os.close, p2cread)
        if c2pwrite != -1 and c2pread != -1 and c2pwrite != devnull:
            stack.callback(os.close, c2pwrite)
        if errwrite != -1 and errread != -1 and errwrite != devnull:
            stack.callback(os.close, errwrite)
        if devnull is not None:
            stack.callback(os.close, devnull)
    self._closed_child_pipe_fds = True
    return None


def install() -> None:
    """From now on, start processes of the package by forking if it makes no difference."""
    subprocess.Popen._execute_child = _start


def start_cold(cold: bool) -> None:
    """Start all processes without forking, or no longer."""
    global _cold
    _cold = cold


def close() -> None:
    """Start processes as Python does, and end the process from which others are forked."""
    global _starter
    subprocess.Popen._execute_child = _true_start
    if _starter is not None and _starter.pid == os.getpid():
        _starter.close()
    _starter = None


def _import_all() -> None:
    """Import all modules of the package and what nodes use of ROS, except what is not installed."""
    package = importlib.import_module(PACKAGE)
    for found in pkgutil.walk_packages(package.__path__, f"{PACKAGE}.", onerror=lambda name: None):
        if not found.name.endswith(".__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(found.name)
    for module in ROS:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    importlib.import_module(f"{PACKAGE}.recordings.cdr").typestore()
    interfaces = [module for name, module in list(sys.modules.items()) if name.endswith((".msg", ".srv"))]
    for kind in {value for module in interfaces for value in vars(module).values() if isinstance(value, type)}:
        if hasattr(type(kind), "__import_type_support__"):
            type(kind).__import_type_support__()


def _load_kernels() -> None:
    """Load the machine code in the cache; kernels that are not in the cache are compiled at their first call."""
    from hysteresis_ros.models.block import COMPILED

    if not COMPILED:
        return
    import numba

    modules = [module for name, module in sys.modules.items() if name.startswith(f"{PACKAGE}.")]
    for kernel in {value for module in modules for value in vars(module).values() if _is_kernel(value, numba)}:
        # Numba has no function for this; in versions with another cache, kernels are loaded at their first call
        with contextlib.suppress(AttributeError, OSError):
            for key in kernel._cache._cache_file._load_index():
                if key[0] not in kernel.overloads:
                    with contextlib.suppress(ReferenceError):  # an argument was a function of a process that has ended
                        kernel.compile(key[0])


def _is_kernel(value, numba) -> bool:
    return isinstance(value, numba.core.dispatcher.Dispatcher)


def _served(channel: socket.socket) -> tuple[dict, list[int]]:
    """Fork for each request; return in the child, with its request and its files."""
    while True:
        data, files, _, _ = socket.recv_fds(channel, 8, 3)
        if len(data) < 8:
            os._exit(0)
        request = json.loads(channel.recv(int.from_bytes(data, "little"), socket.MSG_WAITALL))
        reading, writing = os.pipe()
        between = os.fork()
        if between == 0:
            child = os.fork()
            if child:
                os.write(writing, child.to_bytes(8, "little"))
                os._exit(0)
            os.close(reading)
            os.close(writing)
            channel.close()
            return request, files
        os.close(writing)
        os.waitpid(between, 0)
        answer = os.read(reading, 8)
        os.close(reading)
        for file in files:
            os.close(file)
        channel.sendall(answer)


def _become(request: dict, files: list[int], base: list[str]) -> None:
    """Give this process the state of one that was started normally, and run its module."""
    while os.getppid() != request["parent"]:
        os.sched_yield()
    for standard, file in enumerate(files):
        os.dup2(file, standard)
    for file in files:
        os.close(file)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    if request["session"]:
        os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # imported objects are excluded from collections: otherwise these processes would scan and copy their pages 3 times
    gc.freeze = gc.unfreeze = lambda: None
    unbuffered = bool(request["environment"].get("PYTHONUNBUFFERED"))
    for number, name in ((1, "stdout"), (2, "stderr")):
        raw = io.FileIO(number, "w", closefd=False)
        buffer = raw if unbuffered else io.BufferedWriter(raw)
        errors = "backslashreplace" if number == 2 else "strict"
        options = {"line_buffering": number == 2 or raw.isatty(), "write_through": unbuffered}
        stream = io.TextIOWrapper(buffer, encoding="utf-8", errors=errors, **options)
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    sys.stdin = sys.__stdin__ = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)), encoding="utf-8")
    sys.path[:] = request["path"] + base
    sys.argv[:] = ["-m", *request["arguments"]]
    first = pickle.loads(bytes.fromhex(request["first"]))
    if first is not None:
        first()
    if request["module"] in STARTERS:
        _keep_a_copy(base)
    for name in (request["module"], f"{request['module']}.__main__"):
        sys.modules.pop(name, None)
    _run(request["module"])


def _run(module: str) -> None:
    """Run a module and end as Python does, except that no objects are freed, which would take longer than most run."""
    code: object = None
    try:
        runpy._run_module_as_main(module)
    except SystemExit as error:
        code = error.code
    threading._shutdown()
    atexit._run_exitfuncs()
    if code is None or isinstance(code, int):
        with contextlib.suppress(OSError, ValueError):  # output that cannot be written, and a text, are left to Python
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit((code or 0) & 0xFF)
    sys.exit(code)


def _keep_a_copy(base: list[str]) -> None:
    """Start the processes of this process from a copy of it as it is now, before it runs and has threads."""
    global _starter
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    if os.fork() == 0:
        ours.close()
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _end_with_parent()
        nothing = os.open(os.devnull, os.O_RDWR)
        for standard in range(3):  # the files of this process are closed when it has ended
            os.dup2(nothing, standard)
        os.close(nothing)
        _become(*_served(theirs), base)
        sys.exit(0)
    theirs.close()
    remember_environment()
    _starter = _Starter(ours)
    install()


def _end_with_parent() -> None:
    with contextlib.suppress(OSError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _serve(channel: socket.socket, folder: str) -> None:
    """Import everything and fork for each request; a child of it runs its module here."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with_parent()
    base = sys.path[1:]
    sys.path.insert(1, folder)
    with contextlib.suppress(ImportError):
        importlib.import_module("rclpy")  # with LTTng's threads, which wait for requests to trace: no fork needs them
    threads = os.listdir("/proc/self/task")
    _import_all()
    _load_kernels()
    inspect.getframeinfo(sys._getframe())  # rclpy calls this at each place that logs; the function caches all modules
    gc.collect()
    gc.freeze()
    if os.listdir("/proc/self/task") != threads:
        sys.exit("a library has started a thread, which a fork would not have")
    _become(*_served(channel), base)


if __name__ == "__main__":
    import preloaded_support  # the module, because the one that a child runs takes the place of this one

    preloaded_support._serve(socket.socket(fileno=int(sys.argv[1])), sys.argv[2])
