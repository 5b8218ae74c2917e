"""The one guard around what users bring: calls in a limited time, whose failures name key, method, file and line."""

from collections.abc import Callable
from typing import Any

from drivers.base.call_limit import FAILED, watch
from drivers.base.plugins import Kind, blame, code_file, where


class BadAnswerError(Exception):
    """A plug-in's method returned what it must not; the text says what is wrong with it."""


class Guard:
    """Around a class of users, its objects and their methods.

    kind, name: the key of the rig file and what it says. made: the class. raises: what a failure becomes. file: of the
    class, as tracebacks have it. A tick that calls several objects in a row begins and ends the watch itself, and asks
    `blamed` what to say.
    """

    def __init__(self, kind: Kind, name: str, made: Any, raises: type[Exception] = ValueError) -> None:
        self._kind, self._name, self._made, self._raises = kind, name, made, raises
        self.file = code_file(made)

    def call(self, what: str, method: Callable[..., Any], *arguments: Any, **parameters: Any) -> Any:
        """What a method returns. what: the method in words, or empty. Raises `raises`, whatever the method raises."""
        watch.begin()
        try:
            return method(*arguments, **parameters)
        except FAILED as error:
            raise self._raises(self.told(what, error)) from error
        finally:
            watch.end()

    def told(self, what: str, error: BaseException | str) -> str:
        """What went wrong, with the key; of an exception with its file and line."""
        if isinstance(error, BadAnswerError):
            error = f"{self.file}: {error}"
        text = error if isinstance(error, str) else where(error, self.file)
        return f"{self._kind.path} = {self._name!r}: {what}{': ' if what else ''}{text}"

    def blamed(self, error: BaseException, method: str) -> str:
        """The same in the words of a tick: the kind of plug-in, its name, and the line that it came through, or that of
        the method whose answer was wrong.
        """
        return f"{self._kind.noun} {self._name}: {blame(error, self._made, method)}"
