"""The one guard around what users bring: calls in a limited time, whose failures name key, method, file and line."""

from collections.abc import Callable
from types import TracebackType
from typing import Any

from drivers.base.call_limit import FAILED, watch
from drivers.base.plugins import Kind, blame, code_file, where


class BadAnswerError(Exception):
    """A plug-in's method returned what it must not; the text says what is wrong with it."""


class Limited:
    """`with` around calls in a row, the same object in every tick. Their time is limited, and `failed` gets what they
    raise.
    """

    __slots__ = ("_failed",)

    def __init__(self, failed: Callable[[BaseException], None]) -> None:
        self._failed = failed

    def __enter__(self) -> None:
        watch.begin()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        watch.end()
        if not isinstance(error, FAILED):
            return False
        self._failed(error)
        return True


next_call = watch.renew  # between calls in a row: the limit is that of one call, not of all


class Guard:
    """Around a class of users, its objects and their methods.

    kind, name: the key of the rig file and what it says. made: the class. raises: what a failure becomes. file: of the
    class, as tracebacks have it. One call at a time goes by `call`; calls of a tick go by `limited`.
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

    def limited(self, method: str, keep: Callable[[str], None] | None = None) -> Limited:
        """Around calls of a tick, of the method of that name. keep: gets what to say of a failure; None: it is raised
        as `raises`.
        """

        def failed(error: BaseException) -> None:
            text = self.blamed(error, method)
            if keep is None:
                raise self._raises(text) from error
            keep(text)

        return Limited(failed)

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
