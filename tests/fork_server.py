# SPDX-License-Identifier: Apache-2.0
"""Forks the programs that tests start from a process that has imported them already: the imports
take longer than most tests of the program.

`install` replaces the one function by which `subprocess` starts a program. For `python -m motord`,
`motord.config`, `motord.bus` and a peer of the tests, also with -P, it uses the fork server; for
all else, and wherever a forked process would differ from one started by exec, it uses exec. The
forked process becomes a child of the requesting process: the server is its child and forks twice,
and the nearest ancestor that is a subreaper adopts the process (PR_SET_CHILD_SUBREAPER in
prctl(2)).

A program that starts programs of its own, as the daemon does, gets a server of its own, forked
before it has threads. A program that setsid(1) starts at a terminal of its own, `AT_TERMINAL`, is
forked too. `started_from_nothing` is for tests of the start itself, of memory and of imports.
`make coverage` measures real starts.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import fcntl
import gc
import importlib
import io
import os
import pickle
import re
import resource
import runpy
import signal
import socket
import subprocess
import sys
import termios
import threading
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PEERS = ("tests.peers.ros2.ros2_peer", "tests.sim.straight_on")
HOGGED = "tests.sim.hogged_daemon"
"""Program that calls motord's main(); it is prepared like motord."""
MODULES = ("motord", "motord.config", "motord.bus", *PEERS, HOGGED)
STARTS = {
    "run": (("motord.config",), ("motord.bus",)),
    "demo": (("motord", "simulate"), ("motord.config",), ("motord", "run"), ("motord.bus",)),
    "replay": (("motord.bus",), ("motord.config",)),
}
"""Commands of motord that start programs, and those programs."""
CONFIG, RS485 = "motord.config.load", "motord_hal.rt_engine.rs485."
LATER = {
    "run": (f"{RS485}line", f"{RS485}modbus_frames", "motord_hal.rt_engine.boards.line"),
    "stop-all": (CONFIG, f"{RS485}line", f"{RS485}modbus_frames"),
    **dict.fromkeys(("status", "arm", "disarm", "drive", "stop", "estop", "reset", "params"), ()),
}
"""Modules that a command imports after it has read its arguments; other commands: CONFIG."""
AT_TERMINAL = ("setsid", "--ctty", "--wait")
"""Prefix of a command whose standard input becomes its controlling terminal."""
BUILT_IN = ("PYTHON", "LD_", "COVERAGE", "MALLOC_", "GLIBC_")
"""Prefixes of variables that Python or its libraries read once, at the start."""
REQUEST_BYTES_MAX, FDS_MAX = 1 << 17, 32
NAME_BYTES = 4096
"""Size of the server's command line: room for the command lines of its children."""
ANSWER_WITHIN_S = 100.0
ABOVE = 500
"""Descriptors from this number on are free in a server's child."""
_PR_SET_CHILD_SUBREAPER = 36
_NETWORK, _MOUNTS = "/proc/thread-self/ns/net", "/proc/thread-self/ns/mnt"
_LIMITS = [getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")]
_libc = ctypes.CDLL(None, use_errno=True)
_real = subprocess._fork_exec
subprocess._USE_POSIX_SPAWN = False  # Python 3.13 would start most programs past _fork_exec
_path = sys.path[1:]
"""Where the server looks for modules; before that comes the current folder, without -P."""
_PYTHON = sys.executable
"""The real interpreter: a test may put another program in the place of sys.executable."""
_read = []
_worlds = {}
"""motord's modules for a process that reads robot files itself (False) or not (True): see HERE in
motord/base/validation.py. "now": the installed ones."""


# ------------------------------------------------------------------------------------ a client
class Client:
    """The client of one server, in the process that gets its children."""

    def __init__(self, end, pid=0):
        self.off = False
        self._socket, self._pid = end, pid
        end.settimeout(ANSWER_WITHIN_S)
        self._lock = threading.Lock()
        self._like = _surroundings(), _built_in(os.environ)

    def close(self):
        self.off = True
        self._socket.close()
        if self._pid:
            os.waitpid(self._pid, 0)

    def __call__(self, *given):
        """Start a program like `_posixsubprocess.fork_exec`; return its process number."""
        request = None if self.off else _request(given)
        if request is None or self._like != (_surroundings(), _built_in(request["environ"])):
            return _real(*given)
        with self._lock:
            return self._ask(request) or _real(*given)

    def _ask(self, request):
        fds = request.pop("from")
        _libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        try:
            socket.send_fds(self._socket, [pickle.dumps(request)], fds)
            answer = self._socket.recv(64)
        except (BrokenPipeError, ConnectionResetError):
            answer = b""
        finally:
            _libc.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)
        return int(answer or 0)


def _request(given):
    """Return the request for a server; None for a program that has to be started by exec."""
    (words, paths, close_fds, keep, cwd, env, stdin, _, _, stdout, _, stderr, _, pipe,
     _, new_session, group, gid, gids, uid, umask, preexec, *_) = given  # fmt: skip
    words = [os.fsdecode(word) for word in words]
    programs = [os.fsdecode(path) for path in paths]
    terminal = tuple(words[: len(AT_TERMINAL)]) == AT_TERMINAL
    if terminal:
        words = words[len(AT_TERMINAL) :]
        programs = words[:1]
    safe = words[1:2] == ["-P"]
    words = words[:1] + words[2:] if safe else words
    plain = close_fds and (gid, gids, uid, umask, preexec) == (None, None, None, -1, None)
    if not plain or words[1:2] != ["-m"] or words[2:3] not in ([name] for name in MODULES):
        return None
    if programs != [_PYTHON] or (cwd and not os.path.isdir(cwd)):
        return None
    standard = [number if own < 0 else own for number, own in enumerate((stdin, stdout, stderr))]
    passed = [fd for fd in keep if fd != pipe]
    if not all(os.path.exists(f"/proc/self/fd/{fd}") for fd in standard):
        return None
    return {
        "module": words[2], "words": words[3:], "safe": safe,
        "cwd": os.fsdecode(cwd or os.getcwd()),
        "environ": _environ(env), "from": standard + passed, "to": [0, 1, 2, *passed],
        "new_session": bool(new_session) or terminal, "terminal": terminal, "group": group,
    }  # fmt: skip


def _environ(env):
    if env is None:
        return dict(os.environ)
    pairs = (entry.partition(b"=") for entry in env)
    return {os.fsdecode(name): os.fsdecode(value) for name, _, value in pairs}


def _built_in(environ):
    return {name: value for name, value in environ.items() if name.startswith(BUILT_IN)}


def _surroundings():
    """Return what a child inherits from the process that forks it, and a request cannot set."""
    limits = [resource.getrlimit(number) for number in _LIMITS]
    names = [os.readlink(_NETWORK), os.readlink(_MOUNTS)]
    turn = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0), os.sched_getaffinity(0)
    mask = os.umask(0o077)
    os.umask(mask)
    return os.getsid(0), os.getpgid(0), mask, limits, names, turn


def install():
    """Use a fork server from now on. The server starts with its first request."""
    if not any(name.startswith("COVERAGE") for name in os.environ):
        subprocess._fork_exec = _first


def _first(*given):
    if _request(given) is None:
        return _real(*given)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-m", "tests.fork_server", str(theirs.fileno()), " " * NAME_BYTES]
    subprocess._fork_exec = _real
    with theirs:
        server = subprocess.Popen(command, pass_fds=[theirs.fileno()], cwd=ROOT)
    client = Client(ours, server.pid)
    server.returncode = 0  # so that subprocess does not wait for it: the client does
    atexit.register(client.close)
    subprocess._fork_exec = client
    return client(*given)


@contextlib.contextmanager
def started_from_nothing():
    """Start the programs of this block by exec."""
    before, subprocess._fork_exec = subprocess._fork_exec, _real
    try:
        yield
    finally:
        subprocess._fork_exec = before


# ------------------------------------------------------------------------------------ the server
def serve(end):
    """Serve until the other end is closed, which ends the process. Return in the children only: the
    request that they have to run."""
    while True:
        raw, fds, _, _ = socket.recv_fds(end, REQUEST_BYTES_MAX, FDS_MAX)
        if not raw:
            os._exit(0)
        request = pickle.loads(raw)
        try:
            _prepare(request["module"], request["words"])
            if _fork(end):
                return _become(request, fds, end)
        except Exception:  # noqa: BLE001  a real start shows any error
            traceback.print_exc()
            end.send(b"0")
        for fd in fds:
            os.close(fd)


def _fork(end):
    """Fork twice; return True in the child, which the process at the other end has adopted."""
    assert len(os.listdir("/proc/self/task")) == 1, "no thread but this one lives on in a child"
    gc.freeze()
    middle = os.fork()
    if middle:
        os.waitpid(middle, 0)
        return False
    middle = os.getpid()
    if os.fork():
        os._exit(0)
    while os.getppid() == middle:
        os.sched_yield()
    return True


def _prepare(module, words):
    """Import what the program and those that it starts import, and prepare what they read."""
    module = "motord" if module == HOGGED else module
    command = words[0] if module == "motord" and words else ""
    for other, *its_words in STARTS.get(command, ()):
        _prepare(other, its_words)
    plain = module == "motord.bus" or command == "run"
    _enter(plain)
    for name in _imports(module, command):
        importlib.import_module(name)
    if not plain and CONFIG in sys.modules:
        _read_once()
    if plain:
        for name in _adapters(words):
            importlib.import_module(name)


def _enter(plain):
    """Install motord's modules for a process that leaves robot files to another one (`plain`), or
    that reads them itself."""
    if _worlds.get("now") is plain:
        return
    modules = {
        name: sys.modules[name] for name in list(sys.modules) if name.split(".")[0] == "motord"
    }
    if "now" in _worlds:
        _worlds[_worlds["now"]] = modules
    for name in modules:
        del sys.modules[name]
    sys.modules.update(_worlds.get(plain, {}))
    importlib.import_module("motord.base.validation").HERE = not plain
    _worlds["now"] = plain


def _imports(module, command):
    """Yield the modules that the program imports, also after it has read its arguments."""
    if module == "motord.bus":
        yield "motord.bus.process"
    elif module == "motord.config":
        yield "motord.config.load"
    elif module in PEERS:
        yield module
        del sys.modules[module]  # it is run as __main__; the modules that it imports stay
    elif module == "motord":
        yield "motord.cli"
        if where := importlib.import_module("motord.cli").COMMANDS.get(command):
            yield where[0].partition(":")[0]
        yield from LATER.get(command, (CONFIG,))


def _read_once():
    """Read two robot files, with drives of each kind of table: pydantic makes its validators on
    their first use, which takes ten times as long as reading a file."""
    if not _read:
        answer = sys.modules[CONFIG].answer
        files = [ROOT / f"config/robots/{name}.toml" for name in ("demo", "cia402-two")]
        _read.extend(answer(file, (), None) for file in files)


def _adapters(words):
    """Yield the modules of the kinds of buses that the options set."""
    adapters = importlib.import_module("motord.bus.adapters")
    for kind in re.findall(r"\.kind=([\w-]+)", " ".join(words)):
        for table in (adapters.PUBLISHERS, adapters.INPUTS):
            if where := table.get(kind):
                yield where.partition(":")[0]


def _become(request, fds, end):
    """Turn this process into the one that exec would have made; return the request to run."""
    if request["new_session"]:
        os.setsid()
    elif request["group"] >= 0:
        os.setpgid(0, request["group"])
    *high, ready = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, ABOVE) for fd in (*fds, end.fileno())]
    end.close()
    os.closerange(0, ABOVE)
    for fd, to in zip(high, request["to"], strict=True):
        os.dup2(fd, to)
    if request["terminal"]:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environ"])
    sys.path[:] = _path if request["safe"] else [os.getcwd(), *_path]
    sys.argv = [request["module"], *request["words"]]
    _show_as([sys.executable, *["-P"] * request["safe"], "-m", *sys.argv])
    client = None
    starts = request["module"] in ("motord", HOGGED) and "".join(request["words"][:1]) in STARTS
    if starts:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        if os.fork() == 0:
            ours.close()  # at once: its finalizer would close a later file with this number
            return serve(_alone(theirs))
        theirs.close()
        client = Client(ours)
    subprocess._fork_exec = client or _real
    os.write(ready, str(os.getpid()).encode())
    os.closerange(ABOVE, ABOVE + FDS_MAX + 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _open_standard()
    return request


def _show_as(words):
    """Set /proc/self/cmdline, in the memory of the server's own command line: proc_pid_stat(5)."""
    with open("/proc/self/stat", encoding="ascii") as file:
        begin, end = (int(field) for field in file.read().rpartition(")")[2].split()[45:47])
    raw = b"".join(os.fsencode(word) + b"\0" for word in words)[: end - begin - 1]
    ctypes.memset(begin, 0, end - begin)
    ctypes.memmove(begin, raw, len(raw))


def _alone(end):
    """Return the socket; close all other descriptors and open /dev/null as 0, 1 and 2."""
    keep = fcntl.fcntl(end.detach(), fcntl.F_DUPFD_CLOEXEC, 2 * ABOVE)
    os.closerange(0, 2 * ABOVE)
    for fd in range(3):
        os.open(os.devnull, os.O_RDWR)
        os.set_inheritable(fd, True)  # noqa: FBT003  its signature
    return socket.socket(fileno=keep)


def _open_standard():
    """Open stdin, stdout and stderr like Python at its start: terminals and stderr buffer by lines,
    all else by blocks."""
    unbuffered = bool(os.environ.get("PYTHONUNBUFFERED"))
    encoding = sys.__stdout__.encoding
    for fd, name, errors in (
        (0, "stdin", "strict"),
        (1, "stdout", "strict"),
        (2, "stderr", "backslashreplace"),
    ):
        raw = open(  # noqa: SIM115  for good
            fd, "rb" if fd == 0 else "wb", 0 if unbuffered and fd else -1, closefd=False
        )
        lines = fd == 2 or os.isatty(fd)
        text = io.TextIOWrapper(
            raw, encoding, errors, line_buffering=lines, write_through=unbuffered and fd > 0
        )
        setattr(sys, name, text)
        setattr(sys, f"__{name}__", text)


def main():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    request = serve(socket.socket(fileno=int(sys.argv[1])))
    status = 0
    try:
        runpy.run_module(request["module"], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        status = 0 if end.code is None else end.code
        if not isinstance(status, int) or not _ended():
            raise
    else:
        if not _ended():
            return
    os._exit(status & 0xFF)


def _ended():
    """End like Python, but keep the imported modules: to release them would copy the memory that
    this process shares with its server. Return False if Python has to report an error."""
    threading._shutdown()
    atexit._run_exitfuncs()
    gc.collect()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (AttributeError, OSError, ValueError):  # no stream, or one closed at the other end
        return False
    return True


if __name__ == "__main__":
    importlib.import_module("tests.fork_server").main()
