"""Move a rig on another machine: the same Mover, over TLS."""

import contextlib

from hil.runs.mover import Mover
from hil.telemetry.credentials import Credentials
from hil.telemetry.remote_link import RemoteLink


class RemoteMover(Mover):
    """As Mover; closing it closes the connection."""

    def __init__(self, link: RemoteLink, *, take: bool = False) -> None:
        self._remote = link
        super().__init__(link, take=take)

    def close(self) -> None:
        """Bring to rest what was begun, give the lease back, and leave."""
        try:
            super().close()
        finally:
            self._remote.close()


def remote_motion(where: str, credentials: Credentials, *, take: bool = False) -> RemoteMover:
    """Of the rig at "host:port". One that is READY is activated to hold where it stands, its drives under torque.

    take: also where another client moves it. Raises as RemoteLink, MotionError where the rig cannot hold or is moved by
    somebody else.
    """
    with contextlib.ExitStack() as undo:
        link = undo.enter_context(RemoteLink(where, credentials))
        link.hold()
        mover = RemoteMover(link, take=take)
        undo.pop_all()
    return mover
