"""numba, with compiled code that several processes may keep at once.

numba numbers the files of a function's signatures and keeps an index of the numbers. Two processes
that compile two signatures at the same time may both take one number. The index then names machine
code of another signature, which reads and writes memory that is not its own. And a function may
have another one compiled in: numba does not see that the file of that one changed.

Here the name of a file follows from the signature, so processes only replace a file by its like.
A digest tells whether a file is whole, and whether it was made from today's sources.

numba also counts the functions that a process compiles, and names them in machine code by their
count. Functions that one factory made have one name apart from that. Two processes may give two of
them the same count; what calls both is then linked to one of them (numba issue 10486). Here the
number is random.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import linecache
import pickle
import secrets
from functools import cache, cached_property, partial
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

__all__ = ["jit"]

_CONSTANTS = (bool, int, float, str, bytes, tuple, np.generic)
_DIGEST = hashlib.sha256().digest_size
FunctionIdentity._unique_ids = iter(partial(secrets.randbits, 63), None)


def jit(**options: Any) -> Any:  # noqa: ANN401 - numba has no types
    """The decorator `numba.njit` with `options`; what it compiles is kept beside the source.

    No other thread waits for compiled code (`nogil`), and indices are not checked: callers check
    what they give.
    """

    def compiled(function: FunctionType) -> Any:  # noqa: ANN401
        dispatcher = numba.njit(nogil=True, boundscheck=False, **options)(function)
        dispatcher._cache = _Cache(function)
        return dispatcher

    return compiled


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's, which finds a folder that can be written to, with our files."""

    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        self._cache_file = _CodeFiles(self._cache_path, self._impl.filename_base, function)

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401
        """numba's, but for the implementations of all that a function may call.

        Only compiling needs these, and numba's compiler loads them itself. They take as long to
        load as the code. What manages the memory of arrays is needed, and is made ready here.
        """
        rtsys.initialize(target_context)
        return self._load_overload(sig, target_context)


class _CodeFiles(IndexDataCacheFile):  # type: ignore[misc]
    """The files of one function, of a signature each: a digest, and what is pickled."""

    def __init__(self, folder: str, name: str, function: FunctionType) -> None:
        super().__init__(folder, name, source_stamp=None)
        self._function = function
        self._name = name

    def save(self, key: Any, code: Any) -> None:  # noqa: ANN401
        """Keep code; where the disk is full or may not be written to, it is compiled again."""
        content = dumps((key, code))
        with contextlib.suppress(OSError), self._open_for_write(str(self._path(key))) as file:
            file.write(self._digest_of(content) + content)

    def load(self, key: Any) -> Any:  # noqa: ANN401
        """The code of a signature; None if there is none, or it is damaged or of other sources."""
        try:
            data = self._path(key).read_bytes()
        except OSError:
            return None
        content = data[_DIGEST:]
        if self._digest_of(content) != data[:_DIGEST]:
            return None  # also what another version of numba kept, which this one may not load
        of_key, code = pickle.loads(content)
        return code if of_key == key else None

    def flush(self) -> None:
        """Remove every file of the function."""
        for path in Path(self._cache_path).glob(f"{self._name}.*.nbc"):
            path.unlink(missing_ok=True)

    def _path(self, key: Any) -> Path:  # noqa: ANN401
        return Path(self._cache_path, f"{self._name}.{_digest(repr(key).encode())[:16]}.nbc")

    def _digest_of(self, content: bytes) -> bytes:
        """SHA-256 of a content and of what it was made from."""
        return hashlib.sha256(self._made_from + content).digest()

    @cached_property
    def _made_from(self) -> bytes:
        """Numba's version, and digests of the sources and numbers that the code depends on."""
        sources = {_digest_of_file(__file__)}
        _gather(self._function, sources, set())
        return "\n".join([numba.__version__, *sorted(sources)]).encode()


def _gather(function: FunctionType, sources: set[str], seen: set[FunctionType]) -> None:
    """Digests of the files of a function and of what it calls, and of the constants they name."""
    if function in seen:
        return
    seen.add(function)
    sources.add(_digest_of_file(function.__code__.co_filename))
    variables = inspect.getclosurevars(function)
    for name, value in (*variables.globals.items(), *variables.nonlocals.items()):
        called = getattr(value, "py_func", value)
        if isinstance(called, FunctionType):
            _gather(called, sources, seen)
        elif isinstance(value, np.ndarray):
            sources.add(f"{name} {value.dtype} {value.shape} {_digest(value.tobytes())}")
        elif isinstance(value, _CONSTANTS):
            sources.add(f"{name} {value!r}")


@cache
def _digest_of_file(path: str) -> str:
    return _digest("".join(linecache.getlines(path)).encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
