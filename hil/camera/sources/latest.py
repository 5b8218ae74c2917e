"""The newest image of a source that queues them: read by a thread, the others left out."""

import threading

from hil.camera.contract import Image, Source

_WAIT_S = 1.0


class Latest:
    """source: closed with this one."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._changed = threading.Condition()
        self._newest: Image | None = None
        self._failure: Exception | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._follow, daemon=True, name="images")
        self._thread.start()

    def _follow(self) -> None:
        while not self._closing:
            image, failure = None, None
            try:
                image = self._source.read()
            except Exception as error:  # told to whoever reads
                failure = error
            with self._changed:
                self._newest, self._failure = image or self._newest, failure
                self._changed.notify()
            if failure:
                return

    def read(self) -> Image | None:
        """As Source.read; an image that came before a failure is read first."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._failure, _WAIT_S)
            image, self._newest = self._newest, None
            if image is None and self._failure:
                raise self._failure
            return image

    def close(self) -> None:
        """Once the image that is being read has come."""
        self._closing = True
        self._thread.join(2.0 * _WAIT_S)
        self._source.close()
