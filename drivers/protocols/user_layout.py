"""Frame layouts that users bring: both sides are tried against each other before either is used."""

from drivers.config import Wiring
from drivers.protocols.layout_trial import try_sides
from drivers.protocols.user_sides import Maker, UserDrives, UserHost

_TRIED: set[object] = set()  # the rigs whose sides have understood each other in this process


class UserLayout:
    """The layout of users that [bus] names. Raises LayoutError, also where its sides do not understand each other."""

    def __init__(self, wiring: Wiring) -> None:
        self._maker = Maker(wiring)
        rig = (wiring.bus.model_dump_json(), wiring.n_axes, tuple(wiring.rated_force), wiring.period_ns)
        if rig not in _TRIED:
            try_sides(*self._maker.sides(), self._maker)
            _TRIED.add(rig)

    def host(self) -> UserHost:
        """A new host's side."""
        return self._maker.sides()[0]

    def drives(self) -> UserDrives:
        """A new drives' side."""
        return self._maker.sides()[1]
