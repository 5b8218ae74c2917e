"""Where classes come from: laws, estimators, tasks, stages and frame layouts, our own and everybody else's.

A rig names a class by a name of our own table, by a name that an installed package registers (an entry point), as
`package.module:Class`, or as `./file.py:Class` of a file beside the rig. Key `source` of the same table has the text of
a file, or of a package the digest of its code (package_digest.py). So it is part of the rig's hash, of the recording,
and of the work sent to other processes. Packages are looked for where Python does, and in FOLDER, as long as that is
root's alone.

A name that comes from a recording, or over the network, is its author's: `only` says which code may run meanwhile.
"""

import difflib
import hashlib
import importlib
import inspect
import linecache
import stat
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

DIGEST = "sha256:"  # the digest of a package's code begins with it, and no Python text does
FOLDER = Path("/usr/local/lib/hil/plugins")  # of this machine: `pip install --target`, or plain files, by root


_permitted: ContextVar[Collection[str] | None] = ContextVar("permitted", default=None)


class CodeRefusedError(ValueError):
    """Code that is not ours, and that nobody has allowed to run."""


class Kind(NamedTuple):
    """A kind of plug-in. noun, plural: in words. table, key: of the rig file, where its name stands. group: of entry
    points. ours: our own by name, each `package.module:Name`. methods: what a class of users must have. unlisted: ours
    that are named in full, as no list shows them.
    """

    noun: str
    plural: str
    table: str
    key: str
    group: str
    ours: Mapping[str, str]
    methods: tuple[str, ...]
    unlisted: Collection[str] = ()

    @property
    def path(self) -> str:
        """The key in full, such as law.name."""
        return f"{self.table}.{self.key}"

    def own(self, name: str) -> str:
        """`package.module:Name` of one of ours; empty for others. Ours that end in :FILE stand for every file."""
        if name in self.unlisted:
            return name
        before, colon, _ = name.partition(":")
        return self.ours.get(name, "") or (self.ours.get(f"{before}:FILE", "") if colon else "")


@contextmanager
def only(permitted: Collection[str]) -> Iterator[None]:
    """Within: none runs but ours and those whose `code_digest` is among these; `find` refuses others unread."""
    token = _permitted.set(permitted)
    try:
        yield
    finally:
        _permitted.reset(token)


def code_digest(name: str, source: str) -> str:
    """What the code of a name that is not ours is known by: the SHA-256 of a file's text; of a package the digest that
    `source` holds, or else its name.
    """
    if file_of(name):
        return DIGEST + hashlib.sha256(source.encode()).hexdigest()
    return source if source.startswith(DIGEST) else name


def find(kind: Kind, name: str, source: str = "") -> Any:
    """What a name stands for; source: what the rig carries of it, the text of './file.py:Class' or a package's digest.

    Raises ValueError naming key, value and what is allowed, also where the installed package is another than that; and
    whatever the plug-in's own module raises, as a ValueError with its file and line. CodeRefusedError: see `only`.
    """
    if ours := kind.own(name):
        return load(ours)
    permitted = _permitted.get()
    if permitted is not None and code_digest(name, source) not in permitted:
        raise CodeRefusedError(f"{kind.path} = {name!r:.80} is code that came with the file, and is not run")
    if file := file_of(name):
        attribute = name.rpartition(":")[2]
        return _checked(kind, getattr(_from_source(kind, file, source), attribute, None), name, attribute)
    target = _target(kind, name)
    if not target:
        raise ValueError(unknown(kind, name))
    module, _, attribute = target.partition(":")
    if source and source != (own := _digest_of(module)):
        raise ValueError(
            f"{kind.path} = {name!r}: the installed package is another than this rig's ({source[:15]}, installed "
            f"{own[:15] or 'without a file'}): install that version; a rig file without {kind.table}.source takes any"
        )
    return _checked(kind, load(target, kind), name, attribute)


def package_digest(kind: Kind, name: str) -> str:
    """The digest of the installed package that a name stands for; empty for our own, for files, and for what is not to
    be had. Raises OSError where it cannot be read.
    """
    if kind.own(name) or file_of(name):
        return ""
    return _digest_of(_target(kind, name).partition(":")[0])


def known(kind: Kind, name: str) -> bool:
    """Whether a name may stand for something: one of ours, a registered one, or a class named in full."""
    return name in kind.ours or ":" in name or name in registered(kind)


def registered(kind: Kind) -> list[str]:
    """Names of all that can be had by name: ours, then those of installed packages."""
    _open_folder()
    others = {entry.name for entry in entry_points(group=kind.group)}
    return [*kind.ours, *sorted(others - kind.ours.keys())]


def unknown(kind: Kind, name: str) -> str:
    """What to say of a name that is not known."""
    names = registered(kind)
    nearest = difflib.get_close_matches(name[:40], names, n=1)
    hint = f"the nearest is {nearest[0]}; " if nearest else ""
    return (
        f"{kind.path} = {name!r:.80}: {hint}the {kind.plural} are {', '.join(names)}; or 'package.module:Class', or "
        "'./file.py:Class' of a file beside the rig"
    )


def file_of(name: Any) -> str:
    """The file of a plug-in named ./file.py:Class; empty for other names."""
    file = name.rpartition(":")[0] if isinstance(name, str) else ""
    return file if file.endswith(".py") else ""


def load(target: str, kind: Kind | None = None) -> Any:
    """What `package.module:Name` stands for. kind: whose key is named where it is not to be had (ValueError)."""
    module, _, attribute = target.partition(":")
    if kind is None:
        return getattr(importlib.import_module(module), attribute)
    _open_folder()
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise ValueError(f"{kind.path} = {target!r}: {error}") from None
    except Exception as error:
        raise ValueError(f"{kind.path} = {target!r}: importing it failed: {where(error)}") from error
    return getattr(found, attribute, None)


def where(error: BaseException, file: str = "") -> str:
    """The place, kind and text of an exception: of the last line of `file` that it came through, else of the innermost.

    A module made from a rig's text has the file's name as the rig has it.
    """
    trace, place = error.__traceback__, ""
    while trace is not None:
        name = trace.tb_frame.f_code.co_filename
        if not file or name == file or (not trace.tb_next and not place):
            place = f"{name}:{trace.tb_lineno}: "
        trace = trace.tb_next
    return f"{place}{type(error).__name__.strip('_')}: {error}"


def blame(error: BaseException, made: type, method: str) -> str:
    """The place, kind and text of an exception: of the last line of a plug-in's own file that it came through, or of
    its method, whose answer was wrong.
    """
    file, trace = code_file(made), error.__traceback__
    line = getattr(getattr(getattr(made, method, None), "__code__", None), "co_firstlineno", 0)
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == file:
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"{file}:{line}: {type(error).__name__.strip('_')}: {error}"


def check_parameters(kind: Kind, name: str, made: type, parameters: Mapping[str, Any], given: int) -> None:
    """Raises ValueError naming the parameter that a class does not take, or lacks. given: arguments before them."""
    accepted = list(inspect.signature(made).parameters.values())[given:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted):
        return
    names = [parameter.name for parameter in accepted]
    for key in parameters:
        if key not in names:
            raise ValueError(f"{kind.table}.parameters.{key}: {name} has {', '.join(names) or 'none'}")
    for parameter in accepted:
        if parameter.default is parameter.empty and parameter.name not in parameters:
            raise ValueError(f"{kind.table}.parameters.{parameter.name}: {name} needs it")


def code_file(made: type) -> str:
    """The file that a plug-in's class is from."""
    return str(getattr(sys.modules.get(made.__module__), "__file__", None) or "")


def _digest_of(module: str) -> str:
    from drivers.base.package_digest import digest_of  # few rigs have one

    digest = digest_of(module)
    return DIGEST + digest if digest else ""


def _target(kind: Kind, name: str) -> str:
    """`package.module:Class` of a name that is not ours: itself, or what a package registers; empty where none does."""
    _open_folder()
    if ":" in name:
        return name
    found = [entry for entry in entry_points(group=kind.group) if entry.name == name]
    return f"{found[0].module}:{found[0].attr}" if found else ""


def _checked(kind: Kind, found: Any, name: str, attribute: str) -> Any:
    if isinstance(found, type) and all(callable(getattr(found, method, None)) for method in kind.methods):
        return found
    raise ValueError(f"{kind.path} = {name!r}: {attribute!r} is no class with {' and '.join(kind.methods)}")


@cache
def _open_folder() -> None:
    """Let Python look into FOLDER too, last. What others than root may write to is left out, as if it were not there:
    the control process may run with more rights than they have.
    """
    try:
        found = FOLDER.stat()
    except OSError:
        return
    if found.st_uid == 0 and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and stat.S_ISDIR(found.st_mode):
        sys.path.append(str(FOLDER))


def _from_source(kind: Kind, file: str, source: str) -> ModuleType:
    """A module from the text of a plug-in's file."""
    if not source:
        raise ValueError(f"{kind.path} = '{file}:...': {kind.table}.source is empty; load the rig from its file")
    try:
        return _executed(file, source)
    except Exception as error:
        place = f"{file}:{error.lineno}: {error.msg}" if isinstance(error, SyntaxError) else where(error)
        raise ValueError(f"{kind.path} = '{file}:...': {place}") from error


_BEGUN: set[str] = set()  # modules whose text runs now


@lru_cache(maxsize=64)
def _executed(file: str, source: str) -> ModuleType:
    """Executed once for every text under every name."""
    digest = hashlib.sha256(f"{file}\0{source}".encode()).hexdigest()[:16]
    module = ModuleType(f"hil_plugin_{digest}")
    if module.__name__ in _BEGUN:
        raise ValueError('the file runs itself; put what it runs below `if __name__ == "__main__":`')
    module.__file__ = file
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for tracebacks
    sys.modules[module.__name__] = module  # dataclasses look their module up
    _BEGUN.add(module.__name__)
    try:
        exec(compile(source, file, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[module.__name__]
        raise
    finally:
        _BEGUN.remove(module.__name__)
    return module
