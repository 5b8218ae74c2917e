"""A pytest plug-in: tests written for python-can's `virtual` bus take the `local` bus instead."""

from typing import Any

import can.interfaces
import can.interfaces.virtual

from drivers.bus.local_bus import LocalBus
from tests.peers.results import met


class MetLocalBus(LocalBus):
    """The local bus; whoever opens it has met it."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        met()
        super().__init__(*args, **kwargs)


can.interfaces.BACKENDS["virtual"] = (__name__, "MetLocalBus")
setattr(can.interfaces.virtual, "VirtualBus", MetLocalBus)  # noqa: B010
