"""[axes.NAME.error_map]: what the encoder's scale is wrong by along the travel; `hil accuracy --write` writes it."""

from itertools import pairwise

from pydantic import model_validator

from drivers.base.keys import REQUIRED, Table, key

STEEPEST = 0.01  # correction over way: beyond, encoder_resolution is wrong
MOST_PLACES = 1000


class ErrorMapConfig(Table):
    """[axes.NAME.error_map]: added to the encoder's position; straight lines between, constant beyond both ends.

    Positions and setpoints of the axis are corrected ones from then on.
    """

    position: list[float] = key(
        REQUIRED, "places by the encoder, increasing", "m (rad)", min_length=2, max_length=MOST_PLACES
    )
    correction: list[float] = key(
        REQUIRED, "true position less the encoder's, at each place", "m (rad)", min_length=2, max_length=MOST_PLACES
    )
    date: str = key("", "day of the measurement")
    evidence: str = key("", "file of the reference readings, with its hash")

    @model_validator(mode="after")
    def _a_line(self) -> "ErrorMapConfig":
        if len(self.position) != len(self.correction):
            raise ValueError(f"{len(self.position)} values of position and {len(self.correction)} of correction")
        points = zip(self.position, self.correction, strict=True)
        for (place, value), (beyond, after) in pairwise(points):
            if beyond <= place:
                raise ValueError(f"position: {beyond:g} follows {place:g}; allowed: each above the one before")
            if abs(after - value) > STEEPEST * (beyond - place):
                raise ValueError(
                    f"correction: {value:g} to {after:g} from {place:g} to {beyond:g}; allowed: {STEEPEST:.0%} of the "
                    "way between two places; is encoder_resolution right?"
                )
        return self
