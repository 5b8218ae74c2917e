"""One layered cell: what it bears, how it fades, how it is pierced, and that it never gives back more than it got."""

import hashlib
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_plant.physics.cell import Cell, Handling, Layer, decades_of

MS = 1_000_000
REFERENCE = Layer(0.0, 0.75e-3 / 180e-6**2, 2.0, 0.75e-3, viscous_share=0.4, viscous_time=0.15)
TOUGH = REFERENCE._replace(force=1.0)


class Tip:
    """A tip on its way through a cell, its forces and instants kept."""

    def __init__(
        self, *layers: Layer, handling: Handling | None = None, depth: float = 0.0, piece_ns: int = MS
    ) -> None:
        self.cell = Cell(list(layers), handling)
        self.depth = depth
        self.now_ns = 0
        self.piece_ns = piece_ns
        self.forces = [0.0]
        self.depths = [depth]

    def go(self, to: float, speed: float, lateral: float = 0.0) -> "Tip":
        """To that depth, m, at this speed, m/s."""
        pieces = max(1, round(abs(to - self.depth) / speed * 1e9 / self.piece_ns))
        begin = self.depth
        for index in range(1, pieces + 1):
            self._piece(begin + (to - begin) * index / pieces, lateral)
        return self

    def wait(self, seconds: float) -> "Tip":
        for _ in range(round(seconds * 1e9 / self.piece_ns)):
            self._piece(self.depth, 0.0)
        return self

    def _piece(self, to: float, lateral: float) -> None:
        self.forces.append(self.cell.advance(self.now_ns, self.now_ns + self.piece_ns, self.depth, to, lateral))
        self.depth, self.now_ns = to, self.now_ns + self.piece_ns
        self.depths.append(to)

    @property
    def work(self) -> float:
        """That the tip has done on the cell, J."""
        pairs = zip(self.forces, self.forces[1:], self.depths, self.depths[1:], strict=False)
        return sum(0.5 * (f + g) * (d - c) for f, g, c, d in pairs)


@pytest.mark.parametrize("power", [1.5, 2.0, 3.0])
def test_a_fast_press_meets_the_force_law(power: float) -> None:
    layer = TOUGH._replace(power=power, stiffness=0.5e-3 / 100e-6**power)
    for depth in (20e-6, 50e-6, 100e-6):
        tip = Tip(layer, piece_ns=10_000).go(depth, 1.0)
        assert tip.forces[-1] == pytest.approx(0.5e-3 * (depth / 100e-6) ** power, rel=2e-3)


@pytest.mark.parametrize("speed", [2e-4, 1e-3, 4e-3])
def test_the_force_grows_until_the_puncture_and_is_gone_within_the_slip_time(speed: float) -> None:
    tip = Tip(REFERENCE, piece_ns=250_000, depth=-20e-6).go(400e-6, speed)
    puncture = tip.cell.opening
    assert puncture is not None
    pierced = puncture.at_ns // tip.piece_ns
    rising = tip.forces[: pierced + 1]
    assert rising == sorted(rising)
    assert puncture.force == pytest.approx(0.75e-3, rel=1e-9), "at the force that it bears"
    assert tip.cell.peak_force == pytest.approx(0.75e-3, rel=1e-9)
    assert puncture.speed == pytest.approx(speed, rel=1e-3)
    assert puncture.depth == pytest.approx(-20e-6 + speed * puncture.at_ns * 1e-9, abs=2e-9)
    half, gone = (round((puncture.at_ns + part * 3e6) / tip.piece_ns) for part in (0.5, 1.0))
    assert tip.forces[half] == pytest.approx(0.375e-3, rel=0.1)
    assert tip.forces[gone + 1 :] == [0.0] * len(tip.forces[gone + 1 :])


def test_a_slow_press_goes_deeper_as_part_of_the_force_fades() -> None:
    depths = []
    for speed in (1.0, 4e-3, 1e-3, 2e-4, 1e-5):
        puncture = Tip(REFERENCE, piece_ns=10_000 if speed == 1.0 else MS).go(300e-6, speed).cell.opening
        assert puncture is not None
        depths.append(puncture.depth)
    assert depths == sorted(depths)
    assert depths[0] == pytest.approx(180e-6, rel=1e-3)
    assert depths[-1] == pytest.approx(180e-6 / math.sqrt(0.6), rel=1e-2)


def test_a_held_force_fades_to_its_lasting_part_with_its_time_constant() -> None:
    tip = Tip(TOUGH, piece_ns=10_000).go(100e-6, 1.0)
    tip.piece_ns = MS
    begin = tip.forces[-1]
    tip.wait(0.15)
    assert tip.forces[-1] / begin == pytest.approx(0.6 + 0.4 * math.exp(-1.0), rel=5e-3)
    tip.wait(2.0)
    assert tip.forces[-1] / begin == pytest.approx(0.6, rel=1e-3)


def test_it_takes_time_until_a_cell_is_as_it_was() -> None:
    first = Tip(TOUGH).go(100e-6, 0.1).forces[-1]
    again = {}
    for rest in (0.0, 0.1, 3.0):
        cell = Tip(TOUGH).go(100e-6, 0.1).wait(1.0).go(-10e-6, 0.1)
        cell.now_ns += round(rest * 1e9)  # elsewhere
        again[rest] = cell.go(100e-6, 0.1).forces[-1]
    assert again[0.0] < again[0.1] < again[3.0]
    left = [1.0 - math.sqrt(max(0.0, (again[rest] / first - 0.6) / 0.4)) for rest in (0.0, 0.1)]
    assert left[1] / left[0] == pytest.approx(math.exp(-0.1 / 0.3), rel=0.02), "its depth fades in twice the time"
    assert again[3.0] == pytest.approx(first, rel=1e-3)


def test_more_force_is_borne_for_each_decade_of_loading_speed() -> None:
    layer = REFERENCE._replace(rate_gain=0.1, viscous_share=0.0)
    found = []
    for speed in (1e-4, 1e-3, 1e-2):
        puncture = Tip(layer, piece_ns=100_000).go(300e-6, speed).cell.opening
        assert puncture is not None
        found.append(puncture.force / 0.75e-3)
    assert found == pytest.approx([0.9, 1.0, 1.1], rel=1e-6)


def test_depth_pierces_where_force_does_not() -> None:
    puncture = Tip(TOUGH._replace(puncture_depth=150e-6)).go(300e-6, 1e-3).cell.opening
    assert puncture is not None
    assert puncture.depth == pytest.approx(150e-6, rel=1e-9)
    assert puncture.at_ns == pytest.approx(150_000_000, rel=1e-9)


def test_the_shaft_is_held_inwards_by_friction_and_outwards_by_adhesion() -> None:
    layer = REFERENCE._replace(friction=20e-6, adhesion=50e-6)
    tip = Tip(layer).go(300e-6, 1e-3)
    assert tip.forces[-1] == pytest.approx(20e-6)
    tip.go(100e-6, 1e-3)
    assert tip.forces[-1] == pytest.approx(-50e-6)
    assert tip.cell.peak_pull == pytest.approx(50e-6)
    tip.go(-5e-6, 1e-3)
    assert not tip.cell.is_free, "the membrane is pulled out with the shaft"
    tip.go(-13e-6, 1e-3)
    assert tip.cell.is_free
    assert tip.forces[-1] == 0.0


def test_a_tip_that_comes_again_finds_the_hole() -> None:
    layer = REFERENCE._replace(friction=20e-6, adhesion=20e-6, drag=1e-3)
    tip = Tip(layer).go(300e-6, 1e-3).go(-50e-6, 1e-3)
    assert tip.forces[-1] == 0.0
    tip.go(100e-6, 1e-3)
    assert tip.forces[-1] == pytest.approx(20e-6 + 1e-3 * 1e-3), "the shaft's friction and the drag"
    tip.wait(0.001)
    assert tip.forces[-1] == pytest.approx(20e-6)


def test_a_cell_that_sticks_leaves_the_dish_with_the_pipette() -> None:
    layer = REFERENCE._replace(adhesion=1e-3)
    tip = Tip(layer, handling=Handling(hold=0.4e-3)).go(250e-6, 1e-3).go(-400e-6, 1e-3)
    assert tip.cell.still_on_pipette
    assert tip.cell.peak_pull == pytest.approx(0.4e-3, rel=1e-2)
    assert tip.forces[-1] == 0.0


def test_a_cell_that_rolls_gives_way_aside_and_is_not_pierced() -> None:
    tip = Tip(REFERENCE, handling=Handling(roll_force=0.3e-3, roll_distance=40e-6, roll_time=0.02)).go(160e-6, 1e-3)
    assert tip.cell.moved == 40e-6
    assert tip.cell.opening is None
    assert max(tip.forces) < 0.35e-3
    assert tip.forces[-1] < 0.1e-3


def test_a_tip_that_is_pushed_aside_slips_off() -> None:
    tip = Tip(REFERENCE, handling=Handling(lateral_stiffness=5.0, slip_off=0.5e-3)).go(100e-6, 1e-3)
    assert tip.go(101e-6, 1e-3, lateral=90e-6).forces[-1] > 0.2e-3
    assert tip.go(102e-6, 1e-3, lateral=110e-6).forces[-1] == 0.0
    assert tip.go(103e-6, 1e-3).forces[-1] == 0.0, "until it is out"
    tip.go(-10e-6, 1e-3).wait(1.0)
    assert tip.go(100e-6, 1e-3).forces[-1] > 0.15e-3


def test_a_far_layer_is_met_behind_where_the_cell_was_opened() -> None:
    far = Layer(15e-6, 0.4e-3 / 20e-6**2, 2.0, 0.4e-3, is_far=True)
    tip = Tip(REFERENCE, far, piece_ns=250_000).go(260e-6, 1e-3)
    opening, doubled = tip.cell.opening, tip.cell.far
    assert opening is not None
    assert doubled is not None
    assert doubled.depth == pytest.approx(opening.depth + 35e-6, abs=0.1e-6)
    assert doubled.at_ns == pytest.approx(opening.at_ns + 35_000_000, abs=100_000)


Way = st.lists(st.tuples(st.floats(0.0, 150e-6), st.floats(1e-4, 5e-3), st.floats(0.0, 0.05)), min_size=1, max_size=5)


@settings(max_examples=40)
@given(way=Way, power=st.sampled_from([1.5, 2.0, 3.0]), share=st.floats(0.0, 0.95))
def test_a_cell_that_is_not_pierced_never_gives_back_more_than_it_got(
    way: list[tuple[float, float, float]], power: float, share: float
) -> None:
    layer = TOUGH._replace(power=power, stiffness=0.5e-3 / 100e-6**power, viscous_share=share)
    tip = Tip(layer, piece_ns=250_000)
    for depth, speed, rest in way:
        tip.go(depth, speed).wait(rest)
    tip.go(0.0, 1e-3)
    assert min(tip.forces) >= 0.0
    assert tip.work >= -1e-4 * 0.5e-3 * 100e-6, "as exact as the sum of forces over such pieces is"


def test_pieces_are_no_part_of_the_result() -> None:
    found = []
    for piece_ns in (250_000, 1_000_000, 5_000_000):
        puncture = Tip(REFERENCE._replace(rate_gain=0.1), piece_ns=piece_ns, depth=-5e-6).go(300e-6, 1e-3).cell.opening
        assert puncture is not None
        found.append((puncture.at_ns, puncture.depth, puncture.force))
    assert max(at for at, _, _ in found) - min(at for at, _, _ in found) <= 1
    assert [depth for _, depth, _ in found] == pytest.approx([found[0][1]] * 3, abs=1e-12)


def test_a_trace_is_the_same_on_every_machine() -> None:
    layer = REFERENCE._replace(rate_gain=0.07, friction=20e-6, adhesion=30e-6, power=1.5, stiffness=310.0)
    tip = Tip(layer, TOUGH._replace(offset=190e-6, power=3.0, stiffness=1e7), depth=-3e-6)
    tip.go(250e-6, 1.3e-3).wait(0.02).go(-20e-6, 2e-3)
    assert tip.cell.layers[0].puncture is not None
    digest = hashlib.sha256(struct.pack(f"<{len(tip.forces)}d", *tip.forces)).hexdigest()
    assert digest[:16] == "330f012be898aeee"


@given(st.floats(1e-3, 1e3))
def test_decades_without_a_c_librarys_logarithm(ratio: float) -> None:
    assert decades_of(ratio) == pytest.approx(math.log10(ratio), abs=1e-10)
